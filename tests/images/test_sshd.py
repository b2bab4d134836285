"""What the sshd image lets a robot's key do, asked of the running daemon."""

import contextlib
import json
import re
import socket
import sys
import time

import pytest
from commands import run_command
from jump_people import RobotSshd, end, heartbeat
from robot_key import session_line

USER = "tunnel@127.0.0.1"


def _free_port(key):
    """The robot's rosbridge port, when nobody holds it: sshd hears a moment later that a test has ended its client."""
    ros, _ = key.ports()
    key.stack.wait("the port free", lambda: not _listens(key.stack, ros), "sshd")
    return ros


def _listens(stack, port):
    """Whether somebody answers at a port of sshd's container."""
    connect = ["bash", "-c", f"exec 3<>/dev/tcp/127.0.0.1/{port}"]
    return stack.container("sshd").exec_run(connect).exit_code == 0


# What sshd itself says that is in force, by account.
IN_FORCE = {
    "tunnel": """
    gatewayports clientspecified
    allowtcpforwarding remote
    allowstreamlocalforwarding no
    allowagentforwarding no
    x11forwarding no
    permittty no
    permittunnel no
    permitopen none
    permituserrc no
    passwordauthentication no
    kbdinteractiveauthentication no
    permitrootlogin no
    allowusers tunnel
    allowusers jump
    authorizedkeyscommand /usr/lib/robotether/authorized-keys %u %f %C
    authorizedkeyscommanduser keylookup
    authenticationmethods publickey
    maxsessions 2
    maxauthtries 3
    authorizedkeysfile none
    clientaliveinterval 5
    clientalivecountmax 3
    hostkeyalgorithms ssh-ed25519
    maxstartups 60:70:200
    persourcemaxstartups 20
    unusedconnectiontimeout 10
    persourcepenalties no
    """,
    "jump": """
    authorizedkeyscommand /usr/lib/robotether/jump-keys %f
    authorizedkeyscommanduser keylookup
    authorizedkeysfile none
    authenticationmethods publickey
    allowtcpforwarding local
    permitopen 127.0.0.1:*
    permitlisten none
    gatewayports no
    allowstreamlocalforwarding no
    allowagentforwarding no
    x11forwarding no
    permittty no
    permittunnel no
    permituserrc no
    maxsessions 0
    forcecommand /usr/sbin/nologin
    passwordauthentication no
    kbdinteractiveauthentication no
    unusedconnectiontimeout 10
    """,
}


@pytest.mark.parametrize("account", IN_FORCE)
def test_sshd_runs_for_an_account_with_our_settings(stack, account):
    who = f"user={account},host=somewhere,addr=192.0.2.1"
    found = stack.exec("sshd", "/usr/sbin/sshd", "-T", "-C", who).splitlines()
    wanted = set(map(str.strip, IN_FORCE[account].strip().splitlines()))
    assert wanted - set(found) == set()


def test_an_audit_finds_no_weak_algorithm(stack):
    """ssh-audit fails none of what sshd offers, nor does it know of a weakness of the whole."""
    port = stack.ssh_port
    audit = (sys.executable, "-m", "ssh_audit", "--json", "--skip-rate-test")
    done = run_command(*audit, "-p", str(port), "127.0.0.1")
    found = json.loads(done.stdout)
    offered = [each for kind in ("kex", "key", "enc", "mac") for each in found[kind]]
    assert {each["algorithm"] for each in found["key"]} == {"ssh-ed25519"}
    assert [each for each in offered if "fail" in each["notes"]] == []
    assert found["cves"] == []


def test_robots_with_older_openssh_log_in(key):
    """With the best that OpenSSH 8.2 (Ubuntu 20.04) and 8.4 (Debian 11) have in common with this server."""
    best = ("KexAlgorithms=curve25519-sha256", "MACs=hmac-sha2-256-etm@openssh.com")
    options = [word for option in (*best, "Ciphers=aes128-ctr") for word in ("-o", option)]
    assert "Authenticated to" in key.ssh("-v", *options, USER, "id").stderr


def _sandboxes(stack, program):
    """The user, and how many filters of system calls there are, of each process of a program in sshd's container."""
    statuses = f"cat $(pgrep -x {program} | sed 's|.*|/proc/&/status|')"
    printed = stack.exec("sshd", "bash", "-c", statuses)
    found = re.findall(
        r"^Uid:\t(\d+).*?^Seccomp_filters:\t(\d+)", printed, re.MULTILINE | re.DOTALL
    )
    return [(user, int(count)) for user, count in found]


def test_stranger_talks_to_a_process_in_a_sandbox(stack):
    """Before a log-in it is an account without rights, behind a filter of sshd's own beside the container's."""
    user = stack.exec("sshd", "id", "--user", "sshd").strip()
    [(_, of_container)] = _sandboxes(stack, "sshd")
    with socket.create_connection(("127.0.0.1", stack.ssh_port), timeout=10) as stranger:
        stranger.sendall(b"SSH-2.0-stranger\r\n")
        stack.wait(
            "the sandbox",
            lambda: (user, of_container + 1) in _sandboxes(stack, "sshd-auth"),
            "sshd",
        )
        # In a fleet's return, tunnels go before log-ins, and sshd, which refuses who comes next, before both.
        nice = [_nice(stack, program) for program in ("sshd", "sshd-session", "sshd-auth")]
        assert nice == [{"0"}, {"10"}, {"19"}]


def _nice(stack, program):
    return set(stack.exec("sshd", "ps", "-C", program, "-o", "ni=").split())


def test_programs_of_a_log_in_load_no_library(stack):
    """They would make most of its cost: each is static, at a random address all the same."""
    ours = ("authorized-keys", "key-lookups", "session", "sshd-auth")
    for program in (
        "/usr/sbin/sshd",
        *(f"/usr/lib/openssh/{name}" for name in ("sshd-session", "sshd-auth")),
        *(f"/usr/lib/robotether/{name}" for name in ours),
    ):
        assert "statically linked" in stack.exec("sshd", "ldd", program), program


def test_robot_listens_on_its_own_ports(key, stack, tmp_path):
    """Both ports, added to the live connection as an agent does, listen inside the tunnel network."""
    control = str(tmp_path / "control")
    running = key.start("-M", "-S", control, USER, "session")
    try:
        assert session_line(running)["type"] == "config"
        # As an agent does: the relay ends a session that is silent for 5 s.
        with heartbeat(running):
            for port in key.ports():
                forward = ("-O", "forward", "-R", f"0.0.0.0:{port}:127.0.0.1:9")
                done = key.ssh("-S", control, *forward, USER)
                assert done.returncode == 0, done.stderr
                stack.exec("sshd", "bash", "-c", f"exec 3<>/dev/tcp/127.0.0.1/{port}")
    finally:
        end(running)


def test_robot_gets_nothing_but_its_sessions(key):
    """Whatever the key asks for: no shell, no command, no file transfer, no terminal, no socket file, no port."""
    ros, _ = key.ports()
    refused = "remote port forwarding failed"
    attempts = (
        *(((USER, command), "") for command in ("sh", "session; id", "session x", "internal-sftp")),
        *(((USER, command), "") for command in ("session\nid", "$(id)", "media --robot 1")),
        ((USER,), ""),
        (("-s", USER, "sftp"), "subsystem request failed"),
        (("-tt", USER, "session"), "PTY allocation request failed"),
        (("-N", "-R", "/tmp/thief.sock:127.0.0.1:9", USER), refused),
        *(
            (("-N", "-R", f"0.0.0.0:{port}:127.0.0.1:9", USER), refused)
            for port in (ros + 2, ros - 2, 0, 2222)
        ),
        *(
            (("-W", target, USER), "administratively prohibited")
            for target in ("mysql:3306", "relay:8091", "nginx:8443", f"127.0.0.1:{ros}")
        ),
    )
    answers = key.ssh_each(arguments for arguments, _ in attempts)
    for (arguments, refusal), done in zip(attempts, answers, strict=True):
        assert done.returncode != 0, arguments
        assert refusal in done.stderr, arguments
        assert done.stdout == "", arguments


def test_key_opens_no_other_account(key):
    for account in ("root", "keylookup", "jump"):
        assert "Permission denied" in key.ssh(f"{account}@127.0.0.1", "session").stderr


def test_newer_session_takes_the_ports_over(key, tmp_path):
    ros = _free_port(key)
    running = []
    try:
        for control in (str(tmp_path / "first"), str(tmp_path / "second")):
            running.append(key.start("-M", "-S", control, USER, "session"))
            assert session_line(running[-1])["type"] == "config"
            forward = ("-O", "forward", "-R", f"0.0.0.0:{ros}:127.0.0.1:9")
            done = key.ssh("-S", control, *forward, USER)
            assert done.returncode == 0, done.stderr
        assert running[0].wait(timeout=10) != 0
        assert running[1].poll() is None
    finally:
        for each in running:
            end(each)


@pytest.mark.release
def test_connection_without_a_session_ends(key, stack):
    """A connection that only holds ports is ended, since the relay could not; nor does a client of a port keep it."""
    ros, video = _free_port(key), key.ports()[1]
    with RobotSshd.running() as target:
        used = key.start("-N", "-R", f"0.0.0.0:{ros}:127.0.0.1:{target}", USER)
        unused = key.start("-N", "-R", f"0.0.0.0:{video}:127.0.0.1:9", USER)
        use = f"exec 3<>/dev/tcp/127.0.0.1/{ros} && head -n 1 <&3; sleep 60"
        try:
            stack.wait("both listen", lambda: _listens(stack, ros) and _listens(stack, video))
            stack.container("sshd").exec_run(["bash", "-c", use], detach=True)
            assert unused.wait(timeout=20) != 0
            assert used.wait(timeout=35) != 0
        finally:
            end(used)
            end(unused)


def test_robot_that_reads_nothing_loses_its_session(key, stack):
    """A robot that stops reading cannot keep the connection, and its ports, that the relay has ended."""
    running = key.start(USER, "session")
    try:
        session_line(running)
        # Answers of 4000 digits fill every buffer on the way back, which nobody reads; fewer than 200 lines a second,
        # as the relay ends a robot that sends more for that alone; many at once, so that more has to be written
        # than a pipe's free page takes.
        with contextlib.suppress(BrokenPipeError):
            for first in range(0, 900, 15):
                for seq in range(first, first + 15):
                    ping = f'{{"type": "ping", "seq": {seq}, "t_ms": {"9" * 4000}}}'
                    running.stdin.write(f"{ping}\n")
                running.stdin.flush()
                time.sleep(0.09)
        sessions = "for p in /proc/[0-9]*; do [ $(stat -c %U $p) = tunnel ] && cat $p/cmdline | tr '\\0' ' '; done"
        [[robot_id]] = stack.sql("SELECT id FROM robots WHERE name = 'thief'")
        mine = f"session {robot_id} "
        stack.wait(
            "the session command gone",
            lambda: mine not in stack.exec("sshd", "bash", "-c", f"({sessions}) 2>/dev/null; true"),
            "sshd",
            "relay",
            seconds=20,
        )
    finally:
        running.kill()
        with contextlib.suppress(BrokenPipeError):  # what could not be sent any more
            running.communicate()

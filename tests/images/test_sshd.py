"""What the sshd image lets a robot's key do, asked of the running daemon."""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from database_outage import database_away
from jump_people import RobotSshd, heartbeat
from robot_key import RobotKey
from stack import Stack

USER = "tunnel@127.0.0.1"


@pytest.fixture(scope="module")
def key(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotKey]:
    """The key of an active robot that no agent uses."""
    robot = RobotKey(stack, tmp_path_factory.mktemp("keys"), "thief")
    stack.robotether("robot", "add", "thief", "--mac", "00:00:5e:00:53:60")
    status, _ = robot.join("00:00:5e:00:53:60")
    assert status == 202
    stack.robotether("robot", "approve", "thief", "--yes")
    yield robot
    stack.admin.remove("robots", "thief")


def _session_line(running: subprocess.Popen[str], seconds: float = 10) -> dict[str, object]:
    """The first line that the relay sends on a session, which proves the whole way."""
    assert running.stdout is not None
    ready, _, _ = select.select([running.stdout], [], [], seconds)
    if not ready:
        running.kill()
        raise AssertionError(f"no line in {seconds} s: {running.communicate()[1]}")
    line: dict[str, object] = json.loads(running.stdout.readline())
    return line


def _end(running: subprocess.Popen[str]) -> str:
    running.terminate()
    return running.communicate(timeout=10)[1]


def _free_port(key: RobotKey) -> int:
    """The robot's rosbridge port, when nobody holds it: sshd hears a moment later that a test has ended its client."""
    ros, _ = key.ports()
    connect = ["bash", "-c", f"exec 3<>/dev/tcp/127.0.0.1/{ros}"]
    sshd = key.stack.container("sshd")
    key.stack.wait("the port free", lambda: sshd.exec_run(connect).exit_code != 0, "sshd")
    return ros


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("gatewayports", "clientspecified"),
        ("allowtcpforwarding", "remote"),
        ("allowstreamlocalforwarding", "no"),
        ("allowagentforwarding", "no"),
        ("x11forwarding", "no"),
        ("permittty", "no"),
        ("permittunnel", "no"),
        ("permitopen", "none"),
        ("permituserrc", "no"),
        ("passwordauthentication", "no"),
        ("kbdinteractiveauthentication", "no"),
        ("permitrootlogin", "no"),
        ("usepam", "no"),
        ("allowusers", "tunnel"),
        ("allowusers", "jump"),
        ("authorizedkeyscommand", "/usr/lib/robotether/authorized-keys %u %f %C"),
        ("authorizedkeyscommanduser", "keylookup"),
        ("authenticationmethods", "publickey"),
        ("maxsessions", "2"),
        ("maxauthtries", "3"),
        ("authorizedkeysfile", "none"),
        ("clientaliveinterval", "5"),
        ("clientalivecountmax", "3"),
        ("maxstartups", "30:70:200"),
        ("persourcemaxstartups", "40"),
        ("unusedconnectiontimeout", "10"),
        ("persourcepenalties", "no"),
    ],
)
def test_sshd_runs_for_tunnel_with_the_setting(stack: Stack, setting: str, value: str) -> None:
    """Sshd itself says that the setting is in force for robots."""
    of_tunnel = "user=tunnel,host=somewhere,addr=192.0.2.1"
    printed = stack.exec("sshd", "/usr/sbin/sshd", "-T", "-C", of_tunnel)
    assert f"{setting} {value}" in printed.splitlines()


def test_sshd_offers_no_sftp(stack: Stack) -> None:
    """No subsystem is configured at all."""
    assert "subsystem" not in stack.exec("sshd", "/usr/sbin/sshd", "-T")


def test_robot_opens_its_session(key: RobotKey) -> None:
    """A robot's key reaches the relay, which answers with the robot's name and ports."""
    running = key.start(USER, "session")
    try:
        line = _session_line(running)
    finally:
        _end(running)
    ros, video = key.ports()
    assert (line["type"], line["robot"], line["ros_port"], line["video_port"]) == (
        "config",
        "thief",
        ros,
        video,
    )


def test_robot_opens_its_session_through_443(key: RobotKey) -> None:
    """On a network that lets only 443 out the same key gets the same session."""
    running = key.start(USER, "session", port=key.stack.https_port)
    try:
        assert _session_line(running)["robot"] == "thief"
    finally:
        _end(running)


def test_robot_listens_on_its_own_ports(key: RobotKey, stack: Stack, tmp_path: Path) -> None:
    """Both ports, added to the live connection as an agent does, listen inside the tunnel network."""
    control = str(tmp_path / "control")
    running = key.start("-M", "-S", control, USER, "session")
    try:
        assert _session_line(running)["type"] == "config"
        # As an agent does: the relay ends a session that is silent for 5 s.
        with heartbeat(running):
            for port in key.ports():
                forward = ("-O", "forward", "-R", f"0.0.0.0:{port}:127.0.0.1:9")
                done = key.ssh("-S", control, *forward, USER)
                assert done.returncode == 0, done.stderr
                stack.exec("sshd", "bash", "-c", f"exec 3<>/dev/tcp/127.0.0.1/{port}")
    finally:
        _end(running)


def test_port_that_another_connection_holds_ends_the_session(key: RobotKey) -> None:
    """A session is told why it ends when its port already listens somewhere else."""
    ros = _free_port(key)
    running = key.start("-R", f"0.0.0.0:{ros}:127.0.0.1:9", USER, "session")
    try:
        line = _session_line(running)
    finally:
        _end(running)
    assert (line["type"], line["code"]) == ("bye", "port_taken")


def test_robot_gets_no_other_robots_port(key: RobotKey) -> None:
    """A forward on another robot's port is refused, so no robot can pose as another."""
    ros, _ = key.ports()
    for port in (ros + 2, ros - 2, 80, 2200):
        done = key.ssh("-N", "-R", f"0.0.0.0:{port}:127.0.0.1:9", USER)
        assert done.returncode == 255
        assert "remote port forwarding failed" in done.stderr


@pytest.mark.parametrize(
    "target", ["mysql:3306", "relay:8091", "relay:8080", "web:8000", "127.0.0.1:2222"]
)
def test_robot_reaches_no_service_through_the_server(key: RobotKey, target: str) -> None:
    """A local forward (direct-tcpip) to anything inside is refused."""
    done = key.ssh("-W", target, USER)
    assert done.returncode != 0
    assert "administratively prohibited" in done.stderr or "open failed" in done.stderr


@pytest.mark.parametrize(
    "command",
    [
        "",
        "sh",
        "id",
        "cat /run/secrets/session_key",
        "session; id",
        "shell; id",
        "internal-sftp",
        "session x",
        "shell x",
    ],
)
def test_robot_gets_no_shell(key: RobotKey, command: str) -> None:
    """Whatever the key asks to run but its three kinds of session ends with a sentence and runs nothing."""
    done = key.ssh(USER, *([command] if command else []))
    assert done.returncode != 0
    assert "uid=" not in done.stdout
    assert done.stdout == ""


def test_robot_gets_no_sftp(key: RobotKey) -> None:
    """The sftp subsystem is refused."""
    done = key.ssh("-s", USER, "sftp")
    assert done.returncode != 0
    assert "subsystem request failed" in done.stderr


def test_robot_gets_no_terminal(key: RobotKey) -> None:
    """A pseudo-terminal is refused even for the session command."""
    done = key.ssh("-tt", USER, "session")
    assert done.returncode != 0
    assert "PTY allocation request failed" in done.stderr


def test_robot_gets_no_unix_socket(key: RobotKey) -> None:
    """A remote forward of a socket file is refused."""
    done = key.ssh("-N", "-R", "/tmp/thief.sock:127.0.0.1:9", USER)
    assert done.returncode == 255
    assert "remote port forwarding failed" in done.stderr


@pytest.mark.parametrize("account", ["root", "keylookup", "sshd", "jump"])
def test_key_opens_no_other_account(key: RobotKey, account: str) -> None:
    """The key is good for the account tunnel alone."""
    done = key.ssh(f"{account}@127.0.0.1", "session")
    assert done.returncode == 255
    assert "Permission denied" in done.stderr


def test_unknown_key_leaves_one_audit_line(stack: Stack, tmp_path: Path) -> None:
    """A key that the database does not hold is refused, and one line tells of it however often it tries."""
    stranger = RobotKey(stack, tmp_path, "stranger")
    for _ in range(3):
        assert "Permission denied" in stranger.ssh(USER, "session").stderr
    rows = stack.sql(
        f"SELECT kind, address FROM audit_events WHERE details LIKE '%{stranger.fingerprint}%'"
    )
    assert [row[0] for row in rows] == ["key_refused"]
    assert rows[0][1] not in ("", "NULL")


def test_newer_session_takes_the_ports_over(key: RobotKey, tmp_path: Path) -> None:
    """The second session of a robot gets its port although the first one never let go."""
    ros = _free_port(key)
    running: list[subprocess.Popen[str]] = []
    try:
        for control in (str(tmp_path / "first"), str(tmp_path / "second")):
            running.append(key.start("-M", "-S", control, USER, "session"))
            assert _session_line(running[-1])["type"] == "config"
            forward = ("-O", "forward", "-R", f"0.0.0.0:{ros}:127.0.0.1:9")
            done = key.ssh("-S", control, *forward, USER)
            assert done.returncode == 0, done.stderr
        assert running[0].wait(timeout=10) != 0
        assert running[1].poll() is None
    finally:
        for each in running:
            _end(each)


def test_connection_without_a_session_ends(key: RobotKey) -> None:
    """A connection that only holds ports is ended, since the relay could not end it."""
    ros = _free_port(key)
    holding = key.start("-N", "-R", f"0.0.0.0:{ros}:127.0.0.1:9", USER)
    try:
        assert holding.wait(timeout=20) != 0
    finally:
        _end(holding)


def test_connection_without_a_session_ends_though_somebody_uses_it(
    key: RobotKey, stack: Stack
) -> None:
    """Neither does a client of the robot's port keep such a connection alive."""
    ros = _free_port(key)
    with RobotSshd.running() as target:
        holding = key.start("-N", "-R", f"0.0.0.0:{ros}:127.0.0.1:{target}", USER)
        connect = f"exec 3<>/dev/tcp/127.0.0.1/{ros} && head -n 1 <&3"
        try:
            stack.wait(
                "the port listens",
                lambda: stack.container("sshd").exec_run(["bash", "-c", connect]).exit_code == 0,
            )
            stack.container("sshd").exec_run(["bash", "-c", f"{connect}; sleep 60"], detach=True)
            assert holding.wait(timeout=35) != 0
        finally:
            _end(holding)


def test_robot_that_reads_nothing_loses_its_session(key: RobotKey, stack: Stack) -> None:
    """A robot that stops reading cannot keep the connection, and its ports, that the relay has ended."""
    running = key.start(USER, "session")
    try:
        _session_line(running)
        assert running.stdin is not None
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


def test_known_key_works_while_the_database_is_away(
    key: RobotKey, stack: Stack, tmp_path: Path
) -> None:
    """With mysql stopped a key that worked before still opens its session, and an unknown one does not."""
    running = key.start(USER, "session")
    _session_line(running)
    _end(running)
    with database_away(stack):
        running = key.start(USER, "session")
        try:
            assert _session_line(running)["robot"] == "thief"
        finally:
            _end(running)
        assert "Permission denied" in RobotKey(stack, tmp_path, "late").ssh(USER, "session").stderr


def test_line_that_an_older_version_cached_still_works(key: RobotKey, stack: Stack) -> None:
    """Right after an upgrade, with the database away, robots come back by lines without key and ports."""
    ros, video = key.ports()
    [[robot_id]] = stack.sql("SELECT id FROM robots WHERE name = 'thief'")
    line = (
        f'restrict,port-forwarding,permitlisten="*:{ros}",permitlisten="*:{video}",'
        f'command="/usr/lib/robotether/session {robot_id}" {key.public}'
    )
    file = "/var/cache/robotether/" + key.fingerprint.removeprefix("SHA256:").replace("/", "_")
    with database_away(stack):
        write = f"cat > '{file}' <<< '{line}'"
        stack.exec("sshd", "bash", "-c", write, user="keylookup")
        running = key.start(USER, "session")
        try:
            assert _session_line(running)["robot"] == "thief"
        finally:
            _end(running)


def test_disabled_robots_key_is_refused(stack: Stack, key: RobotKey) -> None:
    """Disabling a robot closes the door to its key at once, cache or not."""
    stack.robotether("robot", "disable", "thief")
    try:
        assert "Permission denied" in key.ssh(USER, "session").stderr
    finally:
        stack.robotether("robot", "enable", "thief")

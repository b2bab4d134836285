"""What the account `jump` lets people do, asked of the running daemon: reach the shells of their robots, no more."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from jump_people import BANNER, JUMP, Person, ShellRobot, end, ended, first_line, lives
from local_network import free_port
from robot_key import RobotKey
from stack import Stack

REGISTER = "/run/robotether/jump"


def registered(stack: Stack) -> list[str]:
    """The files of the register."""
    return stack.exec("sshd", "ls", "-A", REGISTER, user="jump:jumpwatch").split()


@pytest.fixture(scope="module")
def in_force(stack: Stack) -> list[str]:
    """What sshd itself says that is in force for the account."""
    of_jump = "user=jump,host=somewhere,addr=192.0.2.1"
    return stack.exec("sshd", "/usr/sbin/sshd", "-T", "-C", of_jump).splitlines()


@pytest.fixture(scope="module")
def manager(
    stack: Stack,
    tmp_path_factory: pytest.TempPathFactory,
    robot: ShellRobot,
    other: ShellRobot,
) -> Iterator[Person]:
    """Somebody with ann's rights, which no test changes."""
    person = Person(stack, tmp_path_factory.mktemp("manager"), "jumping-manager")
    try:
        person.grant(robot, "manage")
        person.grant(other, "drive")
        yield person
    finally:
        person.remove()


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("authorizedkeyscommand", "/usr/lib/robotether/jump-keys %f"),
        ("authorizedkeyscommanduser", "keylookup"),
        ("authorizedkeysfile", "none"),
        ("authenticationmethods", "publickey"),
        ("allowtcpforwarding", "local"),
        ("permitopen", "127.0.0.1:*"),
        ("permitlisten", "none"),
        ("gatewayports", "no"),
        ("allowstreamlocalforwarding", "no"),
        ("allowagentforwarding", "no"),
        ("x11forwarding", "no"),
        ("permittty", "no"),
        ("permittunnel", "no"),
        ("permituserrc", "no"),
        ("maxsessions", "0"),
        ("forcecommand", "/usr/sbin/nologin"),
        ("passwordauthentication", "no"),
        ("kbdinteractiveauthentication", "no"),
        ("unusedconnectiontimeout", "10"),
    ],
)
def test_sshd_runs_for_jump_with_the_setting(in_force: list[str], setting: str, value: str) -> None:
    """Sshd itself says that the setting is in force for the account."""
    assert f"{setting} {value}" in in_force


def test_person_reaches_the_robot(manager: Person, robot: ShellRobot) -> None:
    """Who manages the robot gets to the first line of its sshd."""
    assert manager.reach(robot.shell_port).stdout.encode() == BANNER.replace(b"\r\n", b"\n")


def test_person_reaches_the_robot_through_443(
    manager: Person, robot: ShellRobot, stack: Stack
) -> None:
    """So does a person on a network that lets only 443 out."""
    target = f"127.0.0.1:{robot.shell_port}"
    done = manager.key.ssh("-W", target, JUMP, port=stack.https_port)
    assert done.stdout.encode() == BANNER.replace(b"\r\n", b"\n")


@pytest.mark.parametrize("level", ["observe", "drive"])
def test_less_than_manage_reaches_nothing(ann: Person, robot: ShellRobot, level: str) -> None:
    """A person who manages no robot does not even get in."""
    ann.grant(robot, level)
    assert "Permission denied" in ann.reach(robot.shell_port).stderr


@pytest.mark.parametrize(
    "target",
    [
        "mysql:3306",
        "relay:8091",
        "relay:9100",
        "web:8000",
        "127.0.0.1:2222",
        "sshd:2222",
        "127.0.0.1:22",
        "[::1]:{shell}",
        "localhost:{shell}",
        "0.0.0.0:{shell}",
        "sshd:{shell}",
        "127.0.0.1:{other}",
        "127.0.0.1:{ros}",
        "127.0.0.1:{video}",
    ],
)
def test_person_reaches_nothing_else(
    manager: Person, robot: ShellRobot, other: ShellRobot, target: str
) -> None:
    """Neither another robot's shell, nor any robot's rosbridge, nor a service of the server."""
    ros, video = robot.key.ports()
    ports = {"shell": robot.shell_port, "other": other.shell_port, "ros": ros, "video": video}
    done = manager.key.ssh("-W", target.format(**ports), JUMP)
    assert done.returncode != 0
    assert done.stdout == ""
    assert "administratively prohibited" in done.stderr


def test_socks_reaches_only_the_robot(
    manager: Person, robot: ShellRobot, other: ShellRobot, stack: Stack
) -> None:
    """A dynamic forward opens what a plain one opens, and no more."""
    port = free_port()
    running = manager.key.start("-N", "-D", f"127.0.0.1:{port}", JUMP)
    try:
        assert stack.wait("the robot", lambda: _through_socks(port, robot.shell_port)) == BANNER
        assert _through_socks(port, other.shell_port) == b""
    finally:
        end(running)


def _through_socks(proxy: int, port: int) -> bytes | None:
    """What 127.0.0.1:PORT says first through a SOCKS 4 proxy; None while the proxy is not there."""
    try:
        connection = socket.create_connection(("127.0.0.1", proxy), timeout=5)
    except OSError:
        return None
    with connection, connection.makefile("rb") as answers:
        connection.sendall(b"\x04\x01" + port.to_bytes(2, "big") + b"\x7f\x00\x00\x01\x00")
        granted = answers.read(8)[1:2] == b"\x5a"
        return answers.readline() if granted else b""


@pytest.mark.parametrize(
    "arguments",
    [
        (JUMP,),
        (JUMP, "id"),
        (JUMP, "session"),
        ("-tt", JUMP),
        ("-s", JUMP, "sftp"),
        ("-s", JUMP, "internal-sftp"),
        ("-N", "-R", "0.0.0.0:0:127.0.0.1:9", JUMP),
        ("-N", "-R", "/tmp/jump.sock:127.0.0.1:9", JUMP),
        ("-W", "/run/secrets/session_key", JUMP),
        ("-N", "-w", "any:any", JUMP),
    ],
    ids=" ".join,
)
def test_person_runs_and_opens_nothing(manager: Person, arguments: tuple[str, ...]) -> None:
    """No shell, no command, no file transfer, no port on the server, no socket file, no network device."""
    # With a path for -W the client waits until sshd ends the connection, after 10 s without a use of it.
    done = manager.key.ssh(*arguments, timeout=40)
    assert done.returncode != 0
    assert done.stdout == ""
    assert "Permission denied" not in done.stderr


def test_persons_key_opens_no_tunnel_and_robots_key_no_jump(
    manager: Person, robot: ShellRobot
) -> None:
    """Each key is good for its own account."""
    assert "Permission denied" in manager.key.ssh("tunnel@127.0.0.1", "session").stderr
    done = robot.key.ssh("-W", f"127.0.0.1:{robot.shell_port}", JUMP)
    assert "Permission denied" in done.stderr


def test_stranger_with_a_public_key_gets_nothing(
    ann: Person, robot: ShellRobot, stack: Stack, tmp_path: Path
) -> None:
    """Who has only the public half does not get in, leaves nothing behind, and disturbs nobody."""
    stolen = tmp_path / "stolen.pub"
    stolen.write_text(ann.key.public + "\n")
    with ann.connected(robot.shell_port) as running:
        # Connections of tests before stay there for a moment.
        stack.wait("she alone in the register", lambda: len(registered(stack)) == 1, "sshd")
        mine = registered(stack)
        bare = ["ssh", "-F", "none", "-p", str(stack.ssh_port), "-i", str(stolen)]
        options = ["BatchMode=yes", "IdentitiesOnly=yes", "StrictHostKeyChecking=no"]
        options.append(f"UserKnownHostsFile={tmp_path / 'known'}")
        arguments = [part for option in options for part in ("-o", option)]
        for _ in range(3):
            done = subprocess.run(
                [*bare, *arguments, "-W", f"127.0.0.1:{robot.shell_port}", JUMP],
                capture_output=True, text=True, timeout=15, stdin=subprocess.DEVNULL, check=False,
            )  # fmt: skip
            assert "Permission denied" in done.stderr
        stack.wait("the register as before", lambda: registered(stack) == mine, "sshd")
        assert lives(running, "still here")


def test_key_that_signs_counts_and_not_one_that_is_shown(
    ann: Person, bob: Person, robot: ShellRobot
) -> None:
    """A connection that offered another person's key first is judged by the key that got in."""
    shown = bob.key.file.with_name("shown.pub")
    shown.write_text(ann.key.public + "\n")
    target = ("-W", f"127.0.0.1:{robot.shell_port}", JUMP)
    running = bob.key.start("-i", str(shown), *target)
    try:
        assert first_line(running).startswith("SSH-2.0")
        ann.lose_grants()
        assert not ended(running, 3)
        assert lives(running, "still here")
        bob.lose_grants()
        assert ended(running)
    finally:
        end(running)


def test_two_people_with_one_key(ann: Person, bob: Person, robot: ShellRobot) -> None:
    """The key opens what either may reach, as long as one of them may."""
    bob.stack.sql(
        f"UPDATE user_ssh_keys SET fingerprint = '{ann.key.fingerprint}', public_key = '{ann.key.public}' "
        f"WHERE fingerprint = '{bob.key.fingerprint}'"
    )
    with ann.connected(robot.shell_port) as running:
        ann.lose_grants()
        assert not ended(running, 3)
        bob.lose_grants()
        assert ended(running)


def test_robot_listens_on_no_shell_port_but_its_own(robot: ShellRobot, other: ShellRobot) -> None:
    """No robot can pose as the shell of another."""
    forward = f"0.0.0.0:{other.shell_port}:127.0.0.1:9"
    done = robot.key.ssh("-N", "-R", forward, "tunnel@127.0.0.1")
    assert "remote port forwarding failed" in done.stderr


def test_robot_without_a_shell_listens_on_no_shell_port(stack: Stack, tmp_path: Path) -> None:
    """A robot whose shell is off gets neither the connection nor the port that it had."""
    made = ShellRobot(stack, tmp_path, "shut", "00:00:5e:00:53:65")
    try:
        port = made.shell_port
        with made.listening() as running:
            made.change("shell = FALSE")
            assert ended(running)
        done = made.key.ssh("-N", "-R", f"0.0.0.0:{port}:127.0.0.1:9", "tunnel@127.0.0.1")
        assert "remote port forwarding failed" in done.stderr
        # A bye may be lost with the connection; an agent asks again too.
        stack.wait("it is told", lambda: "shell_off" in _answer(made.key), "sshd", "relay")
    finally:
        made.remove()


def _answer(key: RobotKey) -> str:
    """What the relay says to a connection for the shell, which it ends."""
    # With its stdin open: an agent that hangs up hears nothing.
    running = key.start("tunnel@127.0.0.1", "shell")
    try:
        assert ended(running, 10)
        assert running.stdout is not None
        return running.stdout.read()
    finally:
        end(running)

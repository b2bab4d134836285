"""Commands on a real sshd: status, output, time-outs, and the end with the connection."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from io import StringIO
from pathlib import Path
from threading import Lock

import fabric
import pytest
from openssh_server import is_alive, wait_until
from robotether_server.cli.fleet import remote, ssh
from robotether_server.cli.fleet.problems import CommandCut
from robotether_server.cli.fleet.remote import MAX_CAPTURED_LENGTH, MAX_LINE_LENGTH, Captured, Lines
from robotether_server.cli.fleet.ssh import SshConnections
from shell_hosts import ShellNetwork

Do = Callable[..., tuple[int, str, str]]


@pytest.fixture
def connection(network: ShellNetwork) -> Iterator[fabric.Connection]:
    connections = SshConnections(accept_new=False)
    yield connections.open(ssh.resolve("sim1", network.config))
    connections.close_all()


@pytest.fixture
def do(connection: fabric.Connection) -> Do:
    def run(command: str, *, timeout_s: float = 20, **how: str) -> tuple[int, str, str]:
        out, err = Captured(), Captured()
        sent = remote.on_lifeline(command)
        status = remote.run(connection, sent, out=out, err=err, timeout_s=timeout_s, **how)
        return status, out.text, err.text

    return run


@pytest.fixture
def fake_sudo(network: ShellNetwork) -> Path:
    """A `sudo` that notes its arguments and, where it is told to, reads a password as the real one does."""
    folder = network.folder / "bin"
    folder.mkdir()
    sudo = folder / "sudo"
    sudo.write_text(
        '#!/bin/sh\necho "sudo $1" >&2\n[ "$1" != -S ] || { read -r pw; echo "got $pw" >&2; shift 2; }\n'
        'shift 2\nexec "$@"\n'
    )
    sudo.chmod(0o755)
    return folder


@pytest.mark.parametrize(
    ("command", "status", "out", "err"),
    [
        ("echo hi", 0, "hi\n", ""),
        ("echo oops >&2; exit 7", 7, "", "oops\n"),
        ("kill -9 $$", 137, "", None),
        ("""printf '%s\n' "it's" '$HOME' \\"x\\" ü""", 0, 'it\'s\n$HOME\n"x"\nü\n', ""),
        ("cat; echo ended", 0, "ended\n", ""),
        ("true\nfalse", 1, "", ""),
        ("printf '\\377'", 0, "\N{REPLACEMENT CHARACTER}", ""),
    ],
)
def test_command_runs_as_it_was_typed(
    do: Do, command: str, status: int, out: str, err: str | None
) -> None:
    """Quotes, line breaks and all; its standard input is empty; a signal is 128 and its number."""
    got = do(command)
    assert got[:2] == (status, out)
    assert err is None or got[2] == err


def test_much_output_comes_whole(do: Do) -> None:
    """More than any buffer on the way."""
    assert do("head -c 1000000 /dev/zero | tr '\\0' x")[:2] == (0, "x" * 1000000)


def pid_written(path: Path) -> int:
    wait_until(lambda: path.exists() and path.read_text().endswith("\n"), lambda: "a command runs")
    return int(path.read_text())


def test_time_out_ends_the_command_on_the_robot(do: Do, tmp_path: Path) -> None:
    """With what it had started."""
    path = tmp_path / "pid"
    with pytest.raises(CommandCut, match=r"timed out after 0\.5 s"):
        do(f"sleep 60 & echo $! > {path}; wait", timeout_s=0.5)
    pid = pid_written(path)
    wait_until(lambda: not is_alive(pid), lambda: "the command has ended")


def test_time_out_is_named_though_its_thread_still_runs(
    do: Do, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lost link would be another problem, with other things to do."""
    released = threading.Event()
    kill = remote.Runner.kill

    def slow_kill(runner: remote.Runner) -> None:
        kill(runner)
        released.wait(20)

    monkeypatch.setattr(remote.Runner, "kill", slow_kill)
    try:
        with pytest.raises(CommandCut, match=r"timed out after 0\.5 s"):
            do("sleep 60", timeout_s=0.5)
    finally:
        released.set()


def test_lost_link_is_no_exit_status(do: Do, network: ShellNetwork, tmp_path: Path) -> None:
    """And no success."""
    stop = f"kill -9 $(ps -o ppid= -p $PPID) & sleep 20 & echo > {tmp_path}/pid; wait"
    with pytest.raises(CommandCut, match="the connection broke"):
        do(stop)


def test_background_process_may_outlive_the_command(do: Do, tmp_path: Path) -> None:
    """As with ssh: what was sent to the background with its outputs elsewhere."""
    path = tmp_path / "pid"
    assert do(f"sleep 60 >/dev/null 2>&1 & echo $! > {path}")[0] == 0
    pid = pid_written(path)
    assert is_alive(pid)
    do(f"kill {pid}")


def test_sudo_never_asks_without_a_password() -> None:
    """-n makes it fail at once where it would ask."""
    sent = remote.on_lifeline("echo $0; id -u", sudo=True)
    assert sent.startswith("sudo -n -- sh -c ")


def test_sudo_gets_its_password_and_the_command_does_not(
    connection: fabric.Connection, fake_sudo: Path
) -> None:
    """The password is the first line of standard input, of which the command sees nothing, asked for or not."""
    for option, said in (("-S", "sudo -S\ngot secret\n"), ("-n", "sudo -n\n")):
        out, err = Captured(), Captured()
        command = remote.on_lifeline("cat; exit 5", sudo=True, password=option == "-S")
        status = remote.run(
            connection,
            f"PATH={fake_sudo}:$PATH {command}",
            out=out,
            err=err,
            timeout_s=20,
            password="secret",
        )
        assert (status, out.text, err.text) == (5, "", said)


def printed(*pieces: str) -> str:
    to = StringIO()
    lines = Lines("sim1 | ", to, Lock())
    for piece in pieces:
        lines.write(piece)
    lines.close()
    lines.close()
    return to.getvalue()


def test_lines_are_passed_on_whole() -> None:
    """However they were cut on the way; a last one gets its end."""
    assert printed("a", "b\nc\n", "\nd") == "sim1 | ab\nsim1 | c\nsim1 | \nsim1 | d\n"


def test_two_robots_lines_never_mix() -> None:
    """One that is not whole yet waits."""
    to, lock = StringIO(), Lock()
    one, two = Lines("1 ", to, lock), Lines("2 ", to, lock)
    one.write("a")
    two.write("b\n")
    one.write("c\n")
    assert to.getvalue() == "2 b\n1 ac\n"


def test_robot_does_not_steer_the_terminal() -> None:
    """Control characters are shown; tabs, line ends of Windows and all letters pass."""
    text = "\x1b[2Ja\tb\rc\x9b\x07ü\r\n"
    assert printed(text) == "sim1 | \\x1b[2Ja\tb\\x0dc\\x9b\\x07ü\n"


def test_line_without_an_end_is_cut() -> None:
    """Nothing is kept without bound."""
    got = printed("x" * (2 * MAX_LINE_LENGTH + 1)).splitlines()
    assert [len(line) for line in got] == [MAX_LINE_LENGTH + 7, MAX_LINE_LENGTH + 7, 8]


def test_kept_output_has_a_bound() -> None:
    """And says that it was cut."""
    captured = Captured()
    captured.write("x" * MAX_CAPTURED_LENGTH)
    assert not captured.cut
    captured.write("y")
    captured.close()
    assert (len(captured.text), captured.cut) == (MAX_CAPTURED_LENGTH, True)

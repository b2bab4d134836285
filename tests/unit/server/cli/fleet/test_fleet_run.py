"""One command on many robots."""

from __future__ import annotations

import signal
from threading import Thread, main_thread

import pytest
from openssh_server import is_alive, wait_until
from robotether_server.cli.fleet import fleet_run, remote
from robotether_server.cli.fleet.fleet_run import Command, FleetRun, captured
from shell_hosts import ShellNetwork


def make(network: ShellNetwork, command: str, *robots: str, timeout_s: float = 20) -> FleetRun:
    line = remote.on_lifeline(command)
    return FleetRun(Command(line, timeout_s, network.config), robots, 2, captured)


def test_each_robot_has_its_outcome(network: ShellNetwork) -> None:
    """One that is offline takes nothing from the other."""
    network.robots["sim2"].stop()
    one, two = sorted(make(network, "echo hi", "sim1", "sim2").run(), key=lambda one: one.robot)
    assert (one.robot, one.status, one.problem) == ("sim1", 0, None)
    assert one.out is not None
    assert one.out.text == "hi\n"
    assert (two.status, two.ok) == (None, False)
    assert two.problem == "cannot reach sim2: it is offline, the server has no tunnel of it"


def test_defect_is_one_robots_outcome(
    network: ShellNetwork, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """With its traceback in the log; the run comes to its end."""
    real = fleet_run.ssh_settings.resolve

    def resolve(name: str, config: object) -> object:
        if name == "sim1":
            raise ZeroDivisionError
        return real(name, network.config)

    monkeypatch.setattr(fleet_run.ssh_settings, "resolve", resolve)
    outcomes = {one.robot: one for one in make(network, "true", "sim1", "sim2").run()}
    assert outcomes["sim1"].problem == "failed: ZeroDivisionError()"
    assert outcomes["sim2"].ok
    assert "Traceback" in caplog.text


def test_ctrl_c_ends_the_command_everywhere(network: ShellNetwork) -> None:
    """On the robots too, and those that had not begun do not begin."""
    pids = network.folder / "pids"
    command = f"sleep 60 & echo $! >> {pids}; wait"
    running = make(network, command, "sim1", "sim2", "sim3")

    def written() -> list[int]:
        return [int(word) for word in pids.read_text().split()] if pids.exists() else []

    def press() -> None:
        wait_until(lambda: len(written()) == 2, lambda: "both robots run it")
        # As from a terminal: a signal ends the wait of the main thread.
        signal.pthread_kill(main_thread().ident or 0, signal.SIGINT)

    presser = Thread(target=press)
    # Whoever starts the tests in the background hands an ignored Ctrl-C down to them.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        presser.start()
        outcomes = running.run()
        presser.join()
    finally:
        signal.signal(signal.SIGINT, before)
    assert running.interrupted
    assert sorted((one.robot, one.status) for one in outcomes) == [
        ("sim1", None),
        ("sim2", None),
        ("sim3", None),
    ]
    assert {one.problem for one in outcomes} == {"interrupted"}
    wait_until(lambda: not any(map(is_alive, written())), lambda: "the commands have ended")


def test_lines_on_the_terminal_have_their_robots_name(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In line, on the stream that they came from."""
    sinks = fleet_run.to_terminal(["sim1", "turtle"])
    out, err = sinks("sim1")
    out.write("hi\n")
    err.write("oops\n")
    assert capsys.readouterr() == ("sim1   | hi\n", "sim1   | oops\n")

"""robotether fleet, as it is typed."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from threading import Barrier, Event, Lock, Thread, main_thread
from typing import Any

import pytest
from openssh_server import is_alive, wait_until
from robotether_server.cli.fleet import commands, remote
from robotether_server.cli.fleet.commands import (
    Command,
    FleetRun,
    Outcome,
    WorkerPool,
    as_dict,
    as_rows,
    captured,
    verdict,
)
from robotether_server.cli.fleet.problems import ConfigUnusable, RobotsUnknown
from robotether_server.cli.fleet.remote import Captured
from shell_hosts import ShellNetwork

Run = Callable[..., Any]


NAMES = [f"sim{number}" for number in range(9)]
OUTCOMES = [
    Outcome("sim3", None, 10.04, "cannot reach sim3: no answer within 10 s"),
    Outcome("sim2", 0, 0.26),
    Outcome("sim1", 3, 1),
]
ROBOTS = """
Host sim1
    HostName 127.0.0.1
    HostKeyAlias robotether-sim1
Host sim2
    HostKeyAlias=robotether-sim2
"""
OTHERS = """
# Host commented
Host bank
    HostKeyAlias my-bank
Host *.lab !gate
    HostKeyAlias robotether-x
Match host sim3
    HostKeyAlias robotether-sim3
Host "an unfinished quote
"""


def test_list_tells_how_robots_are_reached(run_fleet: Run, network: ShellNetwork) -> None:
    """For people and for programs, without a connection."""
    network.stop()
    done = run_fleet("list", "--on", "sim*", "--ssh-config", network.config)
    heads, row, _ = done.out.splitlines()
    jump = f"127.0.0.1:{network.jump.port}"
    assert heads.split() == ["ROBOT", "USER", "PORT", "THROUGH"]
    assert row.split() == ["sim1", network.user, str(network.robots["sim1"].port), jump]
    done = run_fleet("list", "--on", "sim2", "--ssh-config", network.config, "--json")
    assert [one["robot"] for one in json.loads(done.out)] == ["sim2"]


def test_run_prints_lines_and_a_table(run_fleet: Run, network: ShellNetwork) -> None:
    """Lines on standard output, the table on standard error; exit status 0 when all succeeded."""
    done = run_fleet("run", "echo hi", "--on", "sim1", "--on", "*", "--ssh-config", network.config)
    assert (done.status, sorted(done.out.splitlines())) == (0, ["sim1 | hi", "sim2 | hi"])
    lines = done.err.splitlines()
    assert lines[1].split() == ["ROBOT", "SECONDS", "RESULT"]
    assert [line.split()[0::2] for line in lines[2:4]] == [["sim1", "ok"], ["sim2", "ok"]]
    assert lines[4] == "2 of 2 robots: ok"


def test_one_failure_is_the_whole_commands(run_fleet: Run, network: ShellNetwork) -> None:
    """An offline robot is a row with a sentence, not a traceback."""
    network.robots["sim2"].stop()
    done = run_fleet("run", "true", "--on", "*", "--ssh-config", network.config)
    assert done.status == 1
    assert "cannot reach sim2: it is offline" in done.err
    assert done.err.endswith("1 of 2 robots: ok\n")
    assert "Traceback" not in done.err


def test_run_prints_json(run_fleet: Run, network: ShellNetwork) -> None:
    """And nothing else."""
    done = run_fleet("run", "exit 4", "--on", "sim1", "--json", "--ssh-config", network.config)
    assert (done.status, done.err) == (1, "")
    [one] = json.loads(done.out)
    assert (one["robot"], one["status"], one["ok"]) == ("sim1", 4, False)


def test_pattern_without_a_robot(run_fleet: Run, network: ShellNetwork) -> None:
    """One sentence, and nothing runs."""
    done = run_fleet("run", "true", "--on", "elsewhere", "--ssh-config", network.config)
    assert (done.status, done.out, done.err.count("\n")) == (1, "", 1)
    assert "cannot find robots for elsewhere" in done.err


def test_sudo_password_is_asked_once(
    run_fleet: Run, network: ShellNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For all robots, and is shown nowhere."""
    asked: list[str] = []

    def prompt(text: str, **how: bool) -> str:
        assert how["hide_input"]
        asked.append(text)
        return "secret"

    monkeypatch.setattr(commands.click, "prompt", prompt)
    arguments = ("true", "--on", "*", "--ask-sudo-password", "--ssh-config", network.config)
    done = run_fleet("run", *arguments)
    assert asked == ["sudo password"]
    assert "secret" not in done.out + done.err


def test_ctrl_c_is_told_as_a_shell_tells_it(
    run_fleet: Run, network: ShellNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a row for each robot, and status 130."""

    class Interrupted(commands.FleetRun):
        def run(self) -> list[commands.Outcome]:
            self.interrupted = True
            return [commands.Outcome("sim1", None, 0, "interrupted")]

    monkeypatch.setattr(commands, "FleetRun", Interrupted)
    done = run_fleet("run", "true", "--on", "sim1", "--ssh-config", network.config)
    assert done.status == 130
    assert "interrupted" in done.err


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
    assert two.problem == "cannot reach sim2: it is offline: the server has no tunnel to it"


def test_defect_is_one_robots_outcome(
    network: ShellNetwork, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """With its traceback in the log; the run comes to its end."""
    real = commands.ssh.resolve

    def resolve(name: str, config: object) -> object:
        if name == "sim1":
            raise ZeroDivisionError
        return real(name, network.config)

    monkeypatch.setattr(commands.ssh, "resolve", resolve)
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
    sinks = commands.to_terminal(["sim1", "turtle"])
    out, err = sinks("sim1")
    out.write("hi\n")
    err.write("oops\n")
    assert capsys.readouterr() == ("sim1   | hi\n", "sim1   | oops\n")


def test_every_name_is_done_once() -> None:
    """With fewer threads than names, and with more."""
    for parallel in (1, 4, 20):
        assert sorted(WorkerPool(str.upper, NAMES, parallel).results()) == [
            n.upper() for n in NAMES
        ]
    assert list(WorkerPool(str.upper, [], 4).results()) == []


def test_as_many_at_a_time_as_asked() -> None:
    """Three meet at the barrier, and never four."""
    barrier, lock = Barrier(3, timeout=10), Lock()
    at_work: list[int] = []
    most = [0]

    def work(name: str) -> str:
        with lock:
            at_work.append(1)
            most[0] = max(most[0], len(at_work))
        barrier.wait()
        with lock:
            at_work.pop()
        return name

    assert len(list(WorkerPool(work, NAMES, 3).results())) == 9
    assert most[0] == 3


def test_stop_begins_nothing_new() -> None:
    """It returns what those at work bring in time, and waits for no other."""
    going, ending = Event(), Event()
    begun: list[str] = []

    def work(name: str) -> str:
        begun.append(name)
        going.set()
        ending.wait(10)
        return name

    pool = WorkerPool(work, NAMES, 1)
    results = pool.results()
    for thread in pool._threads:
        thread.start()
    assert going.wait(10)
    assert pool.stop(0.01) == []
    ending.set()
    assert pool.stop(10) == ["sim0"]
    assert begun == ["sim0"]
    results.close()


def test_table_has_failures_at_its_end() -> None:
    """Next to the prompt, where a person looks."""
    assert as_rows(OUTCOMES) == [
        ("sim2", "0.3", "ok"),
        ("sim1", "1.0", "exit status 3"),
        ("sim3", "10.0", "cannot reach sim3: no answer within 10 s"),
    ]
    assert verdict(OUTCOMES) == "1 of 3 robots: ok"


def test_json_has_all_of_it() -> None:
    """With outputs where they were kept."""
    out = Captured()
    out.write("hi\n")
    assert as_dict(Outcome("sim1", 0, 0.1234, None, out, Captured())) == {
        "robot": "sim1",
        "ok": True,
        "status": 0,
        "problem": None,
        "seconds": 0.123,
        "stdout": "hi\n",
        "stderr": "",
        "cut": False,
    }
    assert as_dict(OUTCOMES[0])["problem"] == "cannot reach sim3: no answer within 10 s"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config"
    path.write_text(ROBOTS + OTHERS)
    return path


def test_only_what_the_server_printed_is_a_robot(config: Path) -> None:
    """A person's other hosts, patterns and broken lines are none."""
    assert commands.robots_in(config) == {"sim1", "sim2"}


@pytest.mark.parametrize(
    ("patterns", "names"),
    [(["*"], ["sim1", "sim2"]), (["sim2", "sim[12]"], ["sim1", "sim2"]), (["*2"], ["sim2"])],
)
def test_patterns_choose_robots_once(config: Path, patterns: list[str], names: list[str]) -> None:
    """In the order of their names."""
    assert commands.choose(config, patterns) == names


def test_pattern_without_a_robot_is_a_mistake(config: Path) -> None:
    """Even beside another that has some; the sentence lists what there is."""
    with pytest.raises(
        RobotsUnknown, match=r"for bank: .* has sim1, sim2; .* robotether ssh-config"
    ):
        commands.choose(config, ["sim1", "bank"])


def test_included_files_are_read(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By absolute name, or below ~/.ssh, with wildcards."""
    monkeypatch.setenv("HOME", str(tmp_path))
    home = tmp_path / ".ssh"
    home.mkdir()
    (home / "fleet.conf").write_text(ROBOTS.replace("sim2", "turtle"))
    (home / "config").write_text(f"Include fleet.* {config}\n")
    assert commands.choose(None, ["*"]) == ["sim1", "sim2", "turtle"]


def test_file_that_includes_itself_is_refused(tmp_path: Path) -> None:
    """As OpenSSH does, and not for ever."""
    path = tmp_path / "config"
    path.write_text(f"Include {path}\n")
    with pytest.raises(ConfigUnusable, match="over 16 deep"):
        commands.robots_in(path)


def test_missing_file_is_told_with_the_way_to_get_it(tmp_path: Path) -> None:
    """In one sentence."""
    with pytest.raises(ConfigUnusable, match=r"cannot read .*missing.* robotether ssh-config"):
        commands.choose(tmp_path / "missing", ["*"])

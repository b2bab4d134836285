"""robotether fleet, as it is typed."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from robotether_server.cli.fleet import commands
from shell_hosts import ShellNetwork

Run = Callable[..., Any]


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

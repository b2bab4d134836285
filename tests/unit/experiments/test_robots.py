"""Whole robots: addresses, logs, settings, and the end of processes; the robots themselves run in the experiments."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from openssh_server import is_alive, wait_until
from paper import robots
from paper.robots import clean_environment, end, loopback, tail

STUBBORN = "trap '' TERM; sleep 60 & echo $!; wait; wait"


def test_robots_have_addresses_of_their_own() -> None:
    """All on loopback, and none its usual one."""
    made = [loopback(number) for number in range(1, 3000)]
    assert len(set(made)) == len(made)
    assert all(address.startswith("127.") and address != "127.0.0.1" for address in made)


def test_settings_of_this_process_reach_no_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the agent's nor the simulator's; other variables do."""
    monkeypatch.setenv("ROBOTETHER_SERVER", "elsewhere")
    monkeypatch.setenv("SIM_NAME", "other")
    monkeypatch.setenv("LANG", "C")
    given = clean_environment()
    assert given["LANG"] == "C"
    assert not given.keys() & {"ROBOTETHER_SERVER", "SIM_NAME"}


def test_the_end_of_a_log_is_shown(tmp_path: Path) -> None:
    """Also of one that is not there."""
    log = tmp_path / "agent.log"
    assert tail(log) == "(nothing)"
    log.write_text("\n".join(map(str, range(100))))
    assert tail(log).splitlines() == [str(number) for number in range(70, 100)]


def test_a_process_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what it started."""
    monkeypatch.setattr(robots, "ENDS_WITHIN_S", 0.2)
    with subprocess.Popen(["sh", "-c", STUBBORN], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        end(process)
        assert process.returncode == -9
        # A kill is an order: the kernel carries it out a moment later.
        wait_until(lambda: not is_alive(child), lambda: "the child is killed, too")


def test_a_process_that_ended_already_is_left_alone() -> None:
    """Its number may be another one's by then."""
    with subprocess.Popen(["true"]) as process:
        process.wait()
        end(process)
    assert process.returncode == 0

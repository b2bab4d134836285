"""Which robot got its message, what counts as wrong, and how runs are put together."""

from __future__ import annotations

import math
import os
import subprocess
from typing import Any

import pytest
from openssh_server import descendants
from paper.density.report import report
from paper.fleet.operators import Arrivals
from paper.fleet.report import SERVER, Group
from paper.robots import ASIDE, no_longer_aside
from paper.step import Outcome

SECOND_NS = 1_000_000_000


@pytest.fixture
def arrivals() -> Arrivals:
    """Two robots, from second 10 on."""
    return Arrivals(["one", "two"], "start-7", 10 * SECOND_NS)


def test_a_robot_gets_the_text_that_was_sent_to_it(arrivals):
    first, second = arrivals.text("one"), arrivals.text("one")
    arrivals.got("one", first, 12 * SECOND_NS)
    arrivals.got("one", second, 13 * SECOND_NS)
    values = arrivals.values()
    assert values["message_s"] == [2.0, None]
    assert (values["published"], values["received"], values["wrong"]) == (2, 2, 0)
    assert arrivals.has_arrived("one")
    assert not arrivals.has_arrived("two")


@pytest.mark.parametrize(
    ("robot", "text"),
    [
        ("two", "one start-7 1"),
        ("one", "one start-6 1"),
        ("one", "one start-7 2"),
        ("one", "one start-7"),
        ("one", ""),
        ("three", "three start-7 1"),
    ],
)
def test_anything_else_is_wrong(arrivals, robot, text):
    arrivals.text("one")
    arrivals.got(robot, text, 12 * SECOND_NS)
    values = arrivals.values()
    assert (values["wrong"], values["received"]) == (1, 0)
    assert values["wrong_texts"] == [f"{robot} got {text!r}"]


def run(*message_s: float | None) -> dict[str, Any]:
    """What a fleet's start or return brought; None: no message."""
    return {
        "message_s": list(message_s),
        "online_s": list(message_s),
        "server_s": 1.0,
        "received": sum(seconds is not None for seconds in message_s),
        "wrong": 0,
        "waits": {},
        "limits": [],
        "failures": [],
        "cpu_s": dict.fromkeys((*SERVER, "robots"), 0.1),
        "memory_bytes": dict.fromkeys(SERVER, 2**20),
        "took_s": 3.0,
    }


def group_of(*outcomes: Outcome) -> Group:
    return Group("2", 2, outcomes)


def test_a_late_robot_has_failed_and_is_told_apart_from_one_that_never_came():
    group = group_of(Outcome(values=run(1.0, 60.0)), Outcome(values=run(60.1, None)))
    assert (group.wanted, group.in_time, group.late, group.never) == (4, 2, 1, 1)
    assert group.success == 50.0
    assert list(group.seconds("message_s")) == [1.0, 60.0, 60.1]


def test_a_run_that_failed_as_a_whole_counts_all_its_robots():
    group = group_of(Outcome(values=run(1.0, 1.0)), Outcome(failure="a worker ended"))
    assert (group.wanted, group.in_time, group.never, group.success) == (4, 2, 2, 50.0)


def drive(kind: str, *, lost: int = 0, endings: dict[str, int] | None = None) -> dict[str, Any]:
    times = {"1.00": 99, "60.00": 1}
    told = {"sent": 100, "unsent": 0, "lost": lost, "endings": endings or {}, "refused": {}}
    return {"robot": "one", "kind": kind, "round_trips": times, "late": times, **told}


def fleet(*drives: dict[str, Any], back: dict[str, Any] | None = None) -> Outcome:
    used = dict.fromkeys((*SERVER, "robots", "operators", "rest"), 0.5)
    driven = {"drives": list(drives), "fleet_cpu_s": used, "cpu_s": 0.5, "took_s": 2.0}
    values = {"count": 2, "agents": 1, "start": run(1.0, 2.0), "drive": driven}
    return Outcome(values={**values, "return": back or run(3.0, 4.0)})


def test_what_was_lost_or_did_not_come_back_falls_short():
    ended = drive("virtual", lost=1, endings={"close code 4408": 2})
    found = report({"fleet-2": fleet(ended, back=run(3.0, None))})
    short = {row.what for row in found.comparisons if row.is_short}
    assert "2 robots, late or never back after all containers restart" in short
    assert "2 robots, driven at 50 Hz: lost" in short
    assert any("close code 4408 (2)" in line for line in found.shortfalls)
    assert any("the return, all containers: 1 of 2 robots" in line for line in found.shortfalls)


def test_a_drive_that_failed_has_no_figure_and_is_told():
    outcome = fleet()
    assert outcome.values is not None
    failed = Outcome(values={**outcome.values, "drive": {"failure": "no lease"}})
    found = report({"fleet-2": failed})
    row = next(row for row in found.comparisons if row.what.endswith("50 Hz: lost"))
    assert math.isnan(row.ours)
    assert row.is_short
    assert "driving among 2 robots: no lease" in found.shortfalls


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may take a higher priority")
def test_robots_that_are_there_have_the_normal_priority_with_all_that_they_started():
    command = [*ASIDE, "sh", "-c", "sleep 60 & echo; wait"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True) as robot:
        assert robot.stdout is not None
        robot.stdout.readline()
        pids = [robot.pid, *descendants(robot.pid)]
        try:
            before = [os.getpriority(os.PRIO_PROCESS, pid) for pid in pids]
            no_longer_aside([robot.pid])
            after = [os.getpriority(os.PRIO_PROCESS, pid) for pid in pids]
        finally:
            os.killpg(robot.pid, 9)
    assert (before, after) == ([19, 19], [0, 0])

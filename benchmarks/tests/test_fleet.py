"""Which robot got its message, what counts as wrong, and how runs are put together."""

from __future__ import annotations

import os
import subprocess
from typing import Any

import pytest
from openssh_server import descendants
from paper.fleet.operators import Arrivals
from paper.fleet.report import Group
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


def run(*message_s: float | None, **others: Any) -> Outcome:
    """A run in which robots got their messages then; None: never."""
    usual = {
        "message_s": list(message_s),
        "online_s": list(message_s),
        "received": sum(seconds is not None for seconds in message_s),
        "wrong": 0,
        "waits": {},
        "limits": [],
        "cpu_s": {"sshd": 4.0, "relay": 2.0},
        "memory_bytes": {"sshd": 2000},
        "took_s": 3.0,
    }
    return Outcome(values={**usual, **others})


def group_of(*outcomes: Outcome) -> Group:
    return Group("2", 2, outcomes)


def test_a_late_robot_has_failed_and_is_told_apart_from_one_that_never_came():
    group = group_of(run(1.0, 60.0), run(60.1, None))
    assert (group.wanted, group.in_time, group.late, group.never) == (4, 2, 1, 1)
    assert group.success == 50.0
    assert list(group.seconds("message_s")) == [1.0, 60.0, 60.1]


def test_a_run_that_failed_as_a_whole_counts_all_its_robots():
    group = group_of(run(1.0, 1.0), Outcome(failure="a worker ended"))
    assert (group.wanted, group.in_time, group.never, group.success) == (4, 2, 2, 50.0)


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

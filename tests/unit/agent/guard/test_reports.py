"""The lines to the agent."""

from __future__ import annotations

from fake_pipe import FakePipe
from robotether_agent.guard.refused import KINDS
from robotether_agent.guard.reports import (
    COUNTS_EVERY_S,
    MAX_QUEUE_BYTES,
    MOTION_EVERY_S,
    Reports,
    State,
)

STANDS = State(stopped=False, by="", moving=False)
COUNTS = dict.fromkeys(KINDS, 0)


def test_each_line_has_its_type() -> None:
    reports = Reports(pipe := FakePipe())
    reports.ready(40123)
    reports.tick()
    assert pipe.lines == [{"type": "ready", "port": 40123}, {"type": "tick"}]


def test_the_state_is_told_when_it_changes_and_as_an_answer() -> None:
    reports = Reports(pipe := FakePipe())
    reports.state(STANDS, COUNTS)
    reports.state(STANDS, COUNTS)
    reports.state(STANDS, COUNTS, answers="5f")
    reports.state(State(stopped=True, by="ben", moving=True), COUNTS)
    assert [line["answers"] for line in pipe.lines] == [None, "5f", None]
    assert pipe.lines[-1] == {
        "type": "guard",
        "state": "ready",
        "stopped": True,
        "by": "ben",
        "moving": True,
        "answers": None,
        "refused": COUNTS,
    }


def test_a_robot_that_starts_and_stops_all_the_time_is_told_seldom() -> None:
    """As a driver may have it do; and in the end it is told how it is. A stop never waits."""
    now = 5.0
    reports = Reports(pipe := FakePipe(), lambda: now)
    for number in range(1000):
        reports.state(State(stopped=False, by="", moving=number % 2 == 0), COUNTS)
        now += 0.001
    assert 10 < len(pipe.lines) <= 2 / MOTION_EVERY_S + 1
    now += MOTION_EVERY_S
    reports.state(STANDS, COUNTS)
    assert pipe.lines[-1]["moving"] is False
    reports.state(State(stopped=True, by="ben", moving=True), COUNTS)
    assert pipe.lines[-1]["stopped"] is True


def test_what_is_refused_is_told_without_a_motion_too() -> None:
    now, counts = 5.0, dict(COUNTS)
    reports = Reports(pipe := FakePipe(), lambda: now)
    reports.state(STANDS, counts)
    for _ in range(1000):
        counts["held"] += 1
        now += COUNTS_EVERY_S / 500
        reports.state(STANDS, counts)
    assert 1 < len(pipe.lines) <= 3
    now += COUNTS_EVERY_S
    for _ in range(2):
        reports.state(STANDS, counts)
    assert pipe.lines[-1]["refused"]["held"] == 1000
    assert len(pipe.lines) <= 4


def test_an_agent_that_does_not_read_holds_nothing_up() -> None:
    """Its lines are dropped, and the state is told again when it reads."""
    reports = Reports(pipe := FakePipe())
    pipe.waiting = MAX_QUEUE_BYTES + 1
    reports.tick()
    reports.state(STANDS, COUNTS)
    assert pipe.lines == []
    pipe.waiting = 0
    reports.state(STANDS, COUNTS)
    assert len(pipe.lines) == 1

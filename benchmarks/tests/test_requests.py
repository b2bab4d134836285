"""Theory and optimum that the planner is measured by, and the rules of a nemesis with requests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from paper.cells.history import Event
from paper.requests.checker import Record, Records, check
from paper.requests.theory import Job, least_waiting, simulate, waiting_quantile, weighted_waiting

ANY, ARMS = frozenset[str](), frozenset({"arms"})


@pytest.mark.parametrize(("load", "p95_s"), [(0.6, 10.6), (0.8, 63), (0.9, 156)])
def test_theory_gives_the_waiting_of_ten_operators(load: float, p95_s: float) -> None:
    assert waiting_quantile(10, load, 60, 0.95) == pytest.approx(p95_s, rel=0.01)


def test_the_optimum_knows_what_comes() -> None:
    """It keeps the operator free for the urgent request, which costs the low one 11 s in place of 4 * 9."""
    jobs = [Job(0, 10, 3), Job(1, 10, 1)]
    assert weighted_waiting(jobs, simulate(jobs, [ANY])) == 36
    assert least_waiting(jobs, [ANY]) == 11


def test_the_optimum_keeps_to_pools() -> None:
    jobs = [Job(0, 10, 2, "arms"), Job(0, 10, 2, "arms"), Job(0, 10, 2)]
    assert least_waiting(jobs, [ANY, ARMS]) == 20
    assert weighted_waiting(jobs, simulate(jobs, [ANY, ARMS])) == 20


def event(at_s: float, kind: Any, what: str = "", user: str = "") -> Event:
    return Event(at_s=at_s, kind=kind, what=what, connection=user)


def record(at_s: float, kind: str, user: str, request: str = "1") -> Record:
    return Record(at_s=at_s, request=request, kind=f"request_{kind}", user=user)


# Ann leaves when she is offered the request; it passes on to Ben 10 s after her last poll.
HISTORY = [
    event(1, "request_made", "1"),
    event(1.9, "polled", user="ann"),
    event(12.5, "accepted", "1", "ben"),
]
RECORDS = Records(
    requests={"1": ("closed", "ben")},
    log=[
        record(2, "offered", "ann"),
        record(12.0, "passed", "ann"),
        record(12.0, "offered", "ben"),
        record(12.4, "accepted", "ben"),
    ],
)
LATE = [RECORDS.log[0], *(replace(line, at_s=line.at_s + 1) for line in RECORDS.log[1:])]


def test_a_request_that_passes_on_breaks_no_rule() -> None:
    assert check(HISTORY, RECORDS) == []


@pytest.mark.parametrize(
    ("rule", "broken"),
    [
        ("lost request", {"requests": {}}),
        ("lost request", {"requests": {"1": ("waiting", "ben")}}),
        ("given to two", {"requests": {"1": ("closed", "ann")}}),
        ("given to two", {"log": [RECORDS.log[0], *RECORDS.log[2:]]}),
        ("given to two", {"log": [*RECORDS.log[:3], record(12.2, "offered", "ben", "2")]}),
        ("given to two", {"log": [*RECORDS.log[:3], record(12.4, "accepted", "ann")]}),
        ("late pass", {"log": LATE}),
    ],
)
def test_each_rule_can_be_broken(rule: str, broken: dict[str, Any]) -> None:
    assert rule in {violation.rule for violation in check(HISTORY, replace(RECORDS, **broken))}


def test_nobody_passes_on_without_a_database() -> None:
    away = [
        Event(at_s=11, kind="fault", what="database_away"),
        Event(at_s=12, kind="healed", what="database_away"),
    ]
    history = sorted([*HISTORY, *away], key=lambda item: item.at_s)
    assert check(history, replace(RECORDS, log=LATE)) == []

"""What the page makes of cells: broken rules fail the run, aims that are not met fall short."""

from __future__ import annotations

from typing import Any

from paper.cells.report import report, times
from paper.step import Outcome

TRIPS = {"5.00": 99, "50.00": 1}


def nemesis(**others: Any) -> Outcome:
    size = {"cells": 3, "agents": 1, "virtual": 2, "drivers": 1, "observers": 1, "operators": 1}
    seen = {"sent": 100, "heard": 99, "round_trips": TRIPS, "frames": 5, "messages": 6}
    values = {
        "seed": 7,
        "size": {**size, "seconds": 600.0},
        "faults": {"cell_killed": 2},
        "events": {"moved": 99},
        "violations": [],
        "broken": 0,
        "returns": [],
        "ignored_stops_s": [],
        "seen": {**seen, "confirmed_stops": 1},
        "failed": [],
        "online_s": 1.0,
        "crowds": [330, 112],
        "kept": "",
    }
    return Outcome(values={**values, **others})


def short(**outcomes: Outcome) -> dict[str, float]:
    """What is worse than its aim or rule."""
    found = report({name.replace("_", "-"): one for name, one in outcomes.items()})
    return {row.what: row.ours for row in found.comparisons if row.is_short}


def test_a_broken_rule_fails_the_run_and_is_told():
    broken = {"rule": "two drivers", "robot": "one", "at_s": 1.0, "words": "a moves it after b"}
    outcome = nemesis(violations=[broken], broken=1, kept="tests/artifacts/cells/x")
    found = report({"nemesis": outcome})
    [row] = [row for row in found.comparisons if row.is_short and row.better == "equal"]
    assert row.what == "rules broken under the nemesis"
    assert "two drivers: one: a moves it after b" in found.shortfalls
    assert any("seed 7 is in tests/artifacts/cells/x" in line for line in found.shortfalls)


def test_a_robot_that_failed_fails_the_run():
    assert short(nemesis=nemesis(failed=["one: it ended"]))["processes and robots that failed"] == 1


def test_returns_are_judged_by_their_p99():
    late = {"robot": "one", "at_s": 1.0, "took_s": 9.0, "came": True, "after": "cell_paused"}
    found = short(nemesis=nemesis(returns=[late]))
    assert found["drivable again once a live cell is there, p99"] == 9.0
    [row] = report({"nemesis": nemesis(returns=[late])}).values["nemesis"]["return_rows"]
    assert row == {"after": "cell paused", "times": 1, "p50, s": 9, "p99, s": 9, "max, s": 9}


def test_who_gives_up_soon_tells_nothing():
    returns = [
        {"robot": "one", "at_s": 1.0, "took_s": took_s, "came": came}
        for took_s, came in ((1.0, True), (2.0, False), (60.0, False))
    ]
    assert times(returns) == [1.0, 60.0]

"""From outcomes to runs, and from runs to what their spread is made of."""

from __future__ import annotations

import pytest
from paper import spiral_ends
from paper.spiral_course import end_of, punctual, velocities_within
from paper.spiral_ends import Run, Spread
from paper.step import Outcome
from sim_robot.kinematics import Pose

WANTED = velocities_within(2)


def run(pair: int = 1, **changes: object) -> Run:
    usual: dict[str, object] = {
        "network": "fixed",
        "repetition": 1,
        "pair": pair,
        "failure": "",
        "sent_ms": [0, 500, 1000, 1500, 2000],
        "arrived_ms": [5, 505, 1005, 1505, 2005],
        "end": Pose(1.0, 2.0, 0.5),
        "steps": 125,
        "travelled_m": 2.15,
        "path": [(0.0, 0.0), (1.0, 1.0)],
    }
    return Run(**{**usual, **changes})  # type: ignore[arg-type]


def test_outcomes_become_runs_and_failed_drives_none() -> None:
    """A drive that failed has no pairs to tell of."""
    pair = {
        "network": "4g", "pair": 3, "failure": "", "sent_ms": [0], "arrived_ms": [9], "end": [1, 2, 3], "steps": 4,
        "travelled_m": 5, "way": [[6, 7]],
    }  # fmt: skip
    results = {
        "repetition-07": Outcome(
            values={"repetition": 7, "pairs": [pair, {**pair, "end": None, "pair": 4}]}
        ),
        "repetition-08": Outcome(failure="no robots"),
    }
    first, second = spiral_ends.runs(results)
    assert (first.network, first.repetition, first.pair) == ("4g", 7, 3)
    assert (first.end, first.path, first.latencies_ms) == (Pose(1, 2, 3), [(6, 7)], [9])
    assert second.end is None


def test_only_completed_runs_have_ends() -> None:
    """The others are named, each with its reason."""
    given = [run(1), run(2, failure="the connection ended")]
    assert spiral_ends.ends(given) == [Pose(1.0, 2.0, 0.5)]
    assert spiral_ends.failed("fixed", given) == (
        "1 of 2 spirals on fixed, 94/89 Mbit/s were not driven to the end: repetition 1, pair 2: the connection ended."
    )
    assert spiral_ends.failed("4g", given) == ""


def test_the_spread_is_that_of_a_sample() -> None:
    """Two ends 2 mm apart in x."""
    found = Spread.of([Pose(0.0, 1.0, 0.0), Pose(0.002, 1.0, 0.0)])
    assert (found.x_m, found.y_m) == pytest.approx((0.002 / 2**0.5, 0))


def test_commands_that_all_arrive_equally_late_lead_to_the_ideal_end() -> None:
    """Only what changes between commands moves the end; a last one that is late does by its speed."""
    ideal = end_of(punctual(WANTED))
    same = spiral_ends.arrival_end(run(), WANTED)
    assert (same.x, same.y) == pytest.approx((ideal.x, ideal.y))
    late = spiral_ends.arrival_end(run(arrived_ms=[5, 505, 1005, 1505, 2015]), WANTED)
    assert spiral_ends.off_m([run(end=late)], ideal) == [
        pytest.approx(0.01 * WANTED[-1].linear_x, rel=0.01)
    ]


def test_runs_of_the_commonest_steps() -> None:
    """Failed ones do not count."""
    given = [
        run(1, steps=7),
        run(2, steps=8),
        run(3, steps=8),
        *(run(pair, steps=9, failure="x") for pair in range(4, 8)),
    ]
    assert [each.pair for each in spiral_ends.of_commonest_steps(given)] == [2, 3]
    assert spiral_ends.of_commonest_steps([]) == []


def test_intervals_and_latencies() -> None:
    """Between arrivals, and from sending to arrival."""
    assert spiral_ends.intervals_ms([0, 499, 1001]) == [499, 502]
    assert run().latencies_ms == [5] * 5

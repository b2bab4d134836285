"""A run is judged by what reached the robot, and kept as seen from where it started."""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import Mock

import pytest
from paper import spiral_run
from paper.spiral_run import Pair
from sim_robot.kinematics import Velocity

WANTED = [Velocity(1.0, 0.0, 1.0), Velocity(1.05, 0.0, 1.0)]
ARRIVED = [[1_000_000, 1.0, 1.0], [501_000_000, 1.05, 1.0], [1_001_000_000, 0.0, 0.0]]
PAIR = Pair("fixed", 2, Mock(), Mock())


def record(**changes: Any) -> dict[str, Any]:
    seen = {
        "problem": "",
        "arrived": ARRIVED,
        "start": [10.0, 10.0, math.pi / 2],
        "end": [9.0, 12.0, math.pi],
        "stands": True,
        "steps": 62,
        "travelled_m": 1.0252,
        "way": [[10.0, 10.0, math.pi / 2], [10.0, 11.0, math.pi / 2]],
    }
    return {**seen, **changes}


def test_all_commands_in_order_and_a_standing_robot_are_a_completed_run() -> None:
    """There is nothing to complain of."""
    assert spiral_run.failure("", record(), WANTED) == ""


@pytest.mark.parametrize(
    ("problem", "changes", "why"),
    [
        ("the connection ended", {}, "the connection ended"),
        ("", {"problem": "cannot watch"}, "cannot watch"),
        ("", {"arrived": ARRIVED[:2]}, "the robot got 2 of 3 commands"),
        ("", {"arrived": []}, "the robot got 0 of 3 commands"),
        ("", {"arrived": [*ARRIVED, ARRIVED[-1]]}, "the robot got 4 of 3 commands"),
        (
            "",
            {"arrived": [ARRIVED[0], ARRIVED[2], ARRIVED[1]]},
            "the robot was stopped in place of command 2 of 3",
        ),
        (
            "",
            {"arrived": [ARRIVED[1], ARRIVED[2]]},
            "the robot got (1.05, 1.0) in place of command 1 of 3",
        ),
        ("", {"stands": False}, "the robot does not stand after the last command"),
    ],
)
def test_anything_else_is_a_failure_that_says_why(
    problem: str, changes: dict[str, Any], why: str
) -> None:
    """Lost connections, lost, doubled or overtaken commands, stops of the guard, and robots that go on."""
    assert spiral_run.failure(problem, record(**changes), WANTED) == why


def test_what_is_kept_is_seen_from_the_start() -> None:
    """Poses are turned and moved into the frame of the robot that starts, times count from the first sending."""
    kept = spiral_run.outcome(PAIR, [500_000, 500_500_000, 1_000_500_000], "", record(), WANTED)
    assert kept["end"] == pytest.approx([2.0, 1.0, math.pi / 2], abs=1e-6)
    assert kept["way"] == [pytest.approx([0, 0]), pytest.approx([1, 0])]
    assert kept["sent_ms"] == [0.0, 500.0, 1000.0]
    assert kept["arrived_ms"] == [0.5, 500.5, 1000.5]
    assert (kept["network"], kept["pair"], kept["failure"]) == ("fixed", 2, "")

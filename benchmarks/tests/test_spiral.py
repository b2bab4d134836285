"""The spiral is the paper's, turtlesim's steps are turtlesim's, and a run is judged by what reached the robot."""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import Mock

import pytest
from paper.spiral import course, spiral
from paper.spiral.course import Change, end_of, plan_of, punctual, velocities_within
from paper.spiral.report import completed, of_commonest_steps, report, runs_of
from paper.spiral.spiral import Pair
from paper.spiral.watch import Watch
from paper.step import Outcome, Scale
from sim_robot.kinematics import STANDING, STEP_S, Pose, Velocity

BEGINNING = velocities_within(2)
WANTED = [Velocity(1.0, 0.0, 1.0), Velocity(1.05, 0.0, 1.0)]
ARRIVED = [[1_000_000, 1.0, 1.0], [501_000_000, 1.05, 1.0], [1_001_000_000, 0.0, 0.0]]
PAIR = Pair("fixed", 2, Mock(), Mock())


def near(pose: Pose) -> object:
    return pytest.approx((pose.x, pose.y, pose.theta), abs=1e-9)


def test_the_whole_spiral_commands_the_papers_length_in_31_seconds() -> None:
    wanted = course.velocities()
    assert course.commanded_m(wanted) == pytest.approx(78.275)
    assert course.punctual(wanted)[-1] == Change(31.0, STANDING)


def test_fine_steps_would_come_to_the_exact_end() -> None:
    wanted = course.velocities()
    changes = course.punctual(wanted)
    exact = course.end_of(changes)
    most = 2 * STEP_S * wanted[-1].linear_x
    for end in course.stepped_ends(wanted, phases=16):
        assert math.dist((end.x, end.y), (exact.x, exact.y)) < most


def test_a_change_is_taken_at_the_next_step() -> None:
    changes = [Change(0.0, Velocity(1.0, 0.0, 0.0)), Change(2.5 * STEP_S, STANDING)]
    steps = {
        round(course.stepped_end(changes, phase * STEP_S).x / STEP_S) for phase in (0.0, 0.25, 0.75)
    }
    assert steps == {2, 3}


def test_a_pose_is_seen_from_the_start() -> None:
    seen = course.in_frame_of(Pose(3.0, 4.0, math.pi / 2), Pose(3.0, 6.0, math.pi))
    assert (seen.x, seen.y, seen.theta) == near(Pose(2.0, 0.0, math.pi / 2))


def results(*pairs: dict[str, Any]) -> dict[str, Outcome]:
    """A drive with these pairs, and one that failed."""
    usual = {
        "network": "fixed",
        "failure": "",
        "sent_ms": [0, 500, 1000, 1500, 2000],
        "arrived_ms": [5, 505, 1005, 1505, 2005],
        "end": [1.0, 2.0, 0.5],
        "steps": 125,
        "travelled_m": 2.15,
    }
    made = [{**usual, "pair": number, **pair} for number, pair in enumerate(pairs, 1)]
    return {
        "repetition-07": Outcome(values={"repetition": 7, "pairs": made}),
        "repetition-08": Outcome(failure="no robots"),
    }


def test_failed_drives_have_no_runs_and_failed_runs_no_end() -> None:
    runs = runs_of(results({}, {"failure": "it ended", "end": None, "arrived_ms": []}), BEGINNING)
    assert list(runs.repetition) == [7, 7]
    assert list(completed(runs).x) == [1.0]


def test_commands_that_all_arrive_equally_late_lead_to_the_ideal_end() -> None:
    ideal = end_of(punctual(BEGINNING))
    late = {"arrived_ms": [5, 505, 1005, 1505, 2015]}
    runs = runs_of(results({}, late), BEGINNING)
    off = [
        math.dist((run.arrivals_x, run.arrivals_y), (ideal.x, ideal.y)) for run in runs.itertuples()
    ]
    assert off == pytest.approx([0, 0.01 * BEGINNING[-1].linear_x], rel=0.01, abs=1e-9)


def test_runs_of_the_commonest_steps() -> None:
    failed = {"steps": 9, "failure": "x", "arrived_ms": []}
    runs = runs_of(results({"steps": 7}, {"steps": 8}, {"steps": 8}, *[failed] * 4), BEGINNING)
    assert list(of_commonest_steps(runs).pair) == [2, 3]


def test_a_page_has_the_spread_and_what_failed() -> None:
    plan = plan_of(Scale(quick=True))
    came = {"arrived_ms": [500 * number for number in range(len(plan.wanted) + 1)]}
    failed = {"failure": "the connection ended", "arrived_ms": [], "end": None}
    found = report(plan, results(came, {**came, "end": [1.002, 2.0, 0.5]}, failed))
    assert found.values["causes"][0]["driven, mm"] == "1.4 / 0.0"
    assert found.shortfalls == [
        "1 of 3 spirals on fixed, 94/89 Mbit/s were not driven to the end: repetition 7, pair 3: the connection ended."
    ]


def record(**changes: Any) -> dict[str, Any]:
    seen = {
        "problem": "",
        "arrived": ARRIVED,
        "start": [10.0, 10.0, math.pi / 2],
        "end": [9.0, 12.0, math.pi],
        "stands": True,
        "steps": 62,
        "travelled_m": 1.0252,
    }
    return {**seen, **changes}


def test_all_commands_in_order_and_a_standing_robot_are_a_completed_run() -> None:
    assert spiral.failure("", record(), WANTED) == ""


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
    assert spiral.failure(problem, record(**changes), WANTED) == why


def test_what_is_kept_is_seen_from_the_start() -> None:
    kept = spiral.outcome(PAIR, [500_000, 500_500_000, 1_000_500_000], "", record(), WANTED)
    assert kept["end"] == pytest.approx([2.0, 1.0, math.pi / 2], abs=1e-6)
    assert kept["sent_ms"] == [0.0, 500.0, 1000.0]
    assert kept["arrived_ms"] == [0.5, 500.5, 1000.5]
    assert (kept["network"], kept["pair"], kept["failure"]) == ("fixed", 2, "")


def pose(x: float, speed: float) -> dict[str, Any]:
    at = {"x": x, "y": 0.0, "theta": 0.0, "linear_velocity": speed, "angular_velocity": 0.0}
    return {"op": "publish", "topic": "/pose", "msg": at}


def command(speed: float) -> dict[str, Any]:
    twist = {"linear": {"x": speed, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 1.0}}
    return {"op": "publish", "topic": "/cmd_vel", "msg": twist}


def watch(*operations: dict[str, Any]) -> Watch:
    made = Watch("nowhere", "ws://127.0.0.1:9")
    for number, operation in enumerate(operations):
        made.note(number, operation)
    return made


def test_each_moving_pose_is_a_step() -> None:
    seen = watch(pose(9.0, 0.0), pose(10.0, 0.0), *(pose(10.0 + n, 2.0) for n in range(1, 5)))
    assert not seen.stands
    reported = seen.reported()
    assert (reported["steps"], reported["start"], reported["end"]) == (
        4,
        [10.0, 0.0, 0.0],
        [14.0, 0.0, 0.0],
    )
    assert reported["travelled_m"] == pytest.approx(4 * 2.0 * STEP_S)

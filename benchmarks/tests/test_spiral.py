"""The spiral is the paper's, turtlesim's steps are turtlesim's, and a run is judged by what reached the robot."""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import Mock

import pytest
from paper.spiral import course, ends, spiral
from paper.spiral.course import Change, end_of, punctual, velocities_within
from paper.spiral.ends import Run, Spread
from paper.spiral.spiral import Pair
from paper.spiral.watch import Watch
from paper.step import Outcome
from sim_robot.kinematics import STANDING, STEP_S, Pose, Velocity
from sim_robot.settings import SimSettings

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


def test_each_command_is_a_little_faster_and_turns_alike() -> None:
    first = course.velocities()[:3]
    assert [each.linear_x for each in first] == pytest.approx([1.0, 1.05, 1.1])
    assert {each.angular_z for each in first} == {1.0}


def test_a_shortened_spiral_has_the_first_commands() -> None:
    assert course.velocities_within(20) == course.velocities()[:40]


def test_a_full_turn_ends_where_it_began() -> None:
    full = course.along(course.START, Velocity(2.0, 0.0, 1.0), 2 * math.pi)
    half = course.along(course.START, Velocity(2.0, 0.0, 1.0), math.pi)
    assert (full.x, full.y) == pytest.approx((0, 0), abs=1e-9)
    assert (half.x, half.y) == pytest.approx((0, 4), abs=1e-9)


def test_without_a_turn_the_way_is_straight() -> None:
    there = course.along(Pose(1.0, 1.0, math.pi / 2), Velocity(2.0, 0.0, 0.0), 3)
    assert (there.x, there.y) == pytest.approx((1, 7))


def test_the_way_ends_at_the_end() -> None:
    changes = course.punctual(course.velocities())
    end = course.end_of(changes)
    assert list(course.path_of(changes))[-1] == pytest.approx((end.x, end.y))


def test_the_spiral_fits_into_the_simulators_world() -> None:
    room = SimSettings(name="test").world_size_m / 2 - 1
    changes = course.punctual(course.velocities())
    assert all(max(abs(x), abs(y)) < room for x, y in course.path_of(changes))


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


"""From outcomes to runs, and from runs to what their spread is made of."""


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
    first, second = ends.runs(results)
    assert (first.network, first.repetition, first.pair) == ("4g", 7, 3)
    assert (first.end, first.path, first.latencies_ms) == (Pose(1, 2, 3), [(6, 7)], [9])
    assert second.end is None


def test_only_completed_runs_have_ends() -> None:
    given = [run(1), run(2, failure="the connection ended")]
    assert ends.ends(given) == [Pose(1.0, 2.0, 0.5)]
    assert ends.failed("fixed", given) == (
        "1 of 2 spirals on fixed, 94/89 Mbit/s were not driven to the end: repetition 1, pair 2: the connection ended."
    )
    assert ends.failed("4g", given) == ""


def test_the_spread_is_that_of_a_sample() -> None:
    found = Spread.of([Pose(0.0, 1.0, 0.0), Pose(0.002, 1.0, 0.0)])
    assert (found.x_m, found.y_m) == pytest.approx((0.002 / 2**0.5, 0))


def test_commands_that_all_arrive_equally_late_lead_to_the_ideal_end() -> None:
    ideal = end_of(punctual(BEGINNING))
    same = ends.arrival_end(run(), BEGINNING)
    assert (same.x, same.y) == pytest.approx((ideal.x, ideal.y))
    late = ends.arrival_end(run(arrived_ms=[5, 505, 1005, 1505, 2015]), BEGINNING)
    assert ends.off_m([run(end=late)], ideal) == [
        pytest.approx(0.01 * BEGINNING[-1].linear_x, rel=0.01)
    ]


def test_runs_of_the_commonest_steps() -> None:
    given = [
        run(1, steps=7),
        run(2, steps=8),
        run(3, steps=8),
        *(run(pair, steps=9, failure="x") for pair in range(4, 8)),
    ]
    assert [each.pair for each in ends.of_commonest_steps(given)] == [2, 3]
    assert ends.of_commonest_steps([]) == []


def test_intervals_and_latencies() -> None:
    assert ends.intervals_ms([0, 499, 1001]) == [499, 502]
    assert run().latencies_ms == [5] * 5


"""A run is judged by what reached the robot, and kept as seen from where it started."""


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
    assert kept["way"] == [pytest.approx([0, 0]), pytest.approx([1, 0])]
    assert kept["sent_ms"] == [0.0, 500.0, 1000.0]
    assert kept["arrived_ms"] == [0.5, 500.5, 1000.5]
    assert (kept["network"], kept["pair"], kept["failure"]) == ("fixed", 2, "")


"""The watching process keeps what reached a robot and each step that it took."""


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


def test_a_robot_that_stands_is_watched() -> None:
    seen = watch(pose(10.0, 0.0))
    assert seen.watches
    assert seen.stands
    assert (seen.reported()["start"], seen.reported()["steps"]) == ([10.0, 0.0, 0.0], 0)


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
    assert [x for x, _, _ in reported["way"]] == [11.0, 14.0]


def test_the_end_is_where_it_stands_after_its_last_step() -> None:
    seen = watch(pose(10.0, 0.0), pose(11.0, 1.0), pose(11.0, 0.0))
    assert seen.stands
    assert (seen.reported()["start"][0], seen.reported()["end"][0]) == (10.0, 11.0)


def test_commands_are_kept_with_their_moment() -> None:
    seen = watch(command(1.0), {"op": "status", "msg": "none"}, command(1.05))
    assert seen.reported()["arrived"] == [(0, 1.0, 1.0), (2, 1.05, 1.0)]

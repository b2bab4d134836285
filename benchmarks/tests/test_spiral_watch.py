"""The watching process keeps what reached a robot and each step that it took."""

from __future__ import annotations

from typing import Any

import pytest
from paper.spiral_watch import Watch
from sim_robot.kinematics import STEP_S


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
    """Its first pose begins the watch, and it has taken no step."""
    seen = watch(pose(10.0, 0.0))
    assert seen.watches
    assert seen.stands
    assert (seen.reported()["start"], seen.reported()["steps"]) == ([10.0, 0.0, 0.0], 0)


def test_each_moving_pose_is_a_step() -> None:
    """The way is the sum of speeds, and the start is the last pose before the first step."""
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
    """Later poses do not move the start."""
    seen = watch(pose(10.0, 0.0), pose(11.0, 1.0), pose(11.0, 0.0))
    assert seen.stands
    assert (seen.reported()["start"][0], seen.reported()["end"][0]) == (10.0, 11.0)


def test_commands_are_kept_with_their_moment() -> None:
    """What is no message of a topic is not."""
    seen = watch(command(1.0), {"op": "status", "msg": "none"}, command(1.05))
    assert seen.reported()["arrived"] == [(0, 1.0, 1.0), (2, 1.05, 1.0)]

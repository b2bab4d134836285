"""What a drive message says, and how a command is kept within limits."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.commands import (
    MAX_NUMBER,
    MAX_STEP_S,
    SHAPES,
    CheckedCommand,
    DriveLimits,
    Shape,
    Vector,
    limited,
    read,
    write,
    zero,
)
from robotether_agent.guard.refused import Refused

TWIST: dict[str, Any] = {
    "linear": {"x": 1.0, "y": 0.0, "z": 0.0},
    "angular": {"x": 0.0, "y": 0.0, "z": -0.5},
}
HEADER = {"frame_id": "base"}
DRIVE = {
    "steering_angle": 0.1,
    "speed": 2.0,
    "steering_angle_velocity": 0.0,
    "acceleration": 0.0,
    "jerk": 0.0,
}
SLACK = 1 + 1e-9

number = st.floats(-1e6, 1e6)
vector = st.tuples(number, number, number)
# Of a subnormal number the last digits are lost, far below any speed.
limit = st.none() | st.floats(0, 100, allow_subnormal=False)
limits = st.builds(DriveLimits, limit, limit, limit, limit, limit)
commands = st.builds(CheckedCommand, st.just("twist"), vector, vector, number)
step = st.floats(-1, 1e4)


@pytest.mark.parametrize(
    "message", [TWIST, {"header": HEADER, "twist": TWIST}, {"header": HEADER, "drive": DRIVE}]
)
def test_each_shape_comes_out_as_it_went_in(message: dict[str, Any]) -> None:
    """A command within the limits is not changed."""
    assert write(read(message, None)) == message


def test_what_is_left_out_is_zero() -> None:
    command = read({"linear": {"x": 1}}, None)
    assert (command.linear, command.angular) == ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_the_advertised_type_decides_only_when_the_message_says_nothing() -> None:
    assert read({}, "ackermann").shape == "ackermann"
    assert read({"header": {}}, "twist_stamped").shape == "twist_stamped"
    assert read(TWIST, "ackermann").shape == "twist"
    with pytest.raises(Refused):
        read({}, None)


@pytest.mark.parametrize("stamp", ["now", {"secs": 2**40, "nsecs": 4}, {"sec": 2**40}])
@pytest.mark.parametrize("body", [{"twist": TWIST}, {"drive": DRIVE}])
def test_stamp_and_number_are_the_robots(stamp: object, body: dict[str, Any]) -> None:
    """One of the other ROS would make a zero that the robot does not take, one to come a command without end."""
    message = {"header": {**HEADER, "stamp": stamp, "seq": 7}, **body}
    assert write(read(message, None)) == {"header": HEADER, **body}


@pytest.mark.parametrize(
    "message",
    [
        None, [], "x", {"linear": None}, {"linear": [1, 2]}, {"linear": {"x": "1"}}, {"linear": {"x": True}},
        {"linear": {"x": None}}, {"linear": {"x": float("nan")}}, {"linear": {"x": float("inf")}},
        {"linear": {"x": 10**400}}, {"linear": {"x": 1e10}}, {"linear": {"w": 1}}, {"linear": {}, "speed": 3},
        {"twist": 3}, {"twist": {}, "linear": {}}, {"drive": {"speed": "fast"}}, {"drive": {"gear": 1}},
        {"header": 3, "twist": {}}, {"header": {"x": 1}, "twist": {}}, {"header": {"frame_id": "x" * 300}, "twist": {}},
        {"header": {"frame_id": "\ud800"}, "twist": {}}, {"header": {"frame_id": "a\0"}, "twist": {}},
        {"header": {"stamp": {"sec": 1.5}}, "twist": {}}, {"header": {"stamp": {"op": 1}}, "twist": {}},
        {"header": {"seq": -1}, "twist": {}}, {"header": {"stamp": {"sec": 2**70}}, "twist": {}},
    ],
)  # fmt: skip
def test_anything_else_is_no_command(message: object) -> None:
    """Numbers that are none, fields that nobody knows, shapes of other messages."""
    with pytest.raises(Refused) as refused:
        read(message, None)
    assert refused.value.kind == "shape"


@pytest.mark.parametrize("shape", sorted(set(SHAPES.values())))
def test_zero_stands_still(shape: Shape) -> None:
    """Its header names the frame and leaves the time to rosbridge."""
    command = zero(shape, "base")
    assert not command.moves
    written = write(command)
    assert written.get("header", {"frame_id": "base"}) == {"frame_id": "base"}
    assert read(written, None) == command


def test_turning_wheels_alone_is_no_motion() -> None:
    assert not read({"drive": {"steering_angle": 0.3}}, None).moves
    assert read({"drive": {"acceleration": 0.5}}, None).moves
    assert read({"drive": {"speed": -0.1}}, None).moves
    assert read({"angular": {"z": 0.1}}, None).moves


NUMBER = st.one_of(
    st.floats(), st.integers(), st.just(10**400), st.text(max_size=3), st.none(), st.booleans()
)
VECTOR = st.dictionaries(st.sampled_from(["x", "y", "z", "w"]), NUMBER, max_size=3)


@given(
    st.dictionaries(
        st.sampled_from(["linear", "angular", "twist", "header"]), VECTOR | NUMBER, max_size=3
    )
)
def test_whatever_passes_is_finite_and_json(message: dict[str, Any]) -> None:
    try:
        command = read(message, None)
    except Refused:
        return
    numbers = (*command.linear, *command.angular, command.steering)
    assert all(-MAX_NUMBER <= number <= MAX_NUMBER for number in numbers)
    json.dumps(write(command), allow_nan=False)


def length(values: Vector) -> float:
    return math.hypot(*values)


def driven(speed: float) -> CheckedCommand:
    return CheckedCommand("twist", (speed, 0.0, 0.0))


@given(commands, st.none() | commands, step, limits)
def test_no_command_exceeds_a_limit(
    wanted: CheckedCommand, before: CheckedCommand | None, step_s: float, within: DriveLimits
) -> None:
    """Whatever came before and whenever that was."""
    got = limited(wanted, before, step_s, within)
    if within.max_speed_m_s is not None:
        assert length(got.linear) <= within.max_speed_m_s * SLACK
    if within.max_turn_rad_s is not None:
        assert length(got.angular) <= within.max_turn_rad_s * SLACK
    if within.max_steering_rad is not None:
        assert abs(got.steering) <= within.max_steering_rad
    if within.max_acceleration_m_s2 is not None:
        had = length(before.linear) if before else 0.0
        assert (
            length(got.linear) <= (had + within.max_acceleration_m_s2 * MAX_STEP_S) * SLACK + 1e-9
        )


@given(commands, st.none() | commands, step, limits)
def test_a_command_only_becomes_slower_and_keeps_its_direction(
    wanted: CheckedCommand, before: CheckedCommand | None, step_s: float, within: DriveLimits
) -> None:
    """A limit never turns, speeds up or reverses a robot."""
    got = limited(wanted, before, step_s, within)
    for asked, given_ in zip(
        (*wanted.linear, *wanted.angular), (*got.linear, *got.angular), strict=True
    ):
        assert abs(given_) <= abs(asked) * SLACK
        assert asked * given_ >= 0


@given(vector, st.floats(0, 1), step, limits)
def test_braking_is_never_delayed(
    before: Vector, part: float, step_s: float, within: DriveLimits
) -> None:
    """Less of the same motion passes as it is, if the robot was within its speed."""
    x, y, z = before
    wanted = CheckedCommand("twist", (x * part, y * part, z * part), (x * part, y * part, z * part))
    growth = DriveLimits(
        None, None, within.max_acceleration_m_s2, within.max_turn_acceleration_rad_s2, None
    )
    got = limited(wanted, CheckedCommand("twist", before, before), step_s, growth)
    assert math.dist(got.linear, wanted.linear) <= length(wanted.linear) * 1e-9
    assert math.dist(got.angular, wanted.angular) <= length(wanted.angular) * 1e-9


@given(commands, step, limits)
def test_a_stop_is_a_stop(before: CheckedCommand, step_s: float, within: DriveLimits) -> None:
    assert not limited(CheckedCommand("twist"), before, step_s, within).moves


def test_speed_grows_by_the_acceleration() -> None:
    """From 1 m/s with 2 m/s2, 50 ms later: 1.1 m/s."""
    got = limited(driven(5), driven(1), 0.05, DriveLimits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], 1.1)


def test_a_pause_is_not_made_up_for() -> None:
    """After ten seconds a robot that stood begins as slowly as always."""
    got = limited(driven(5), None, 10, DriveLimits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], 2 * MAX_STEP_S)


def test_the_other_way_begins_at_a_standstill() -> None:
    """Full reverse brakes at once and then grows as from zero."""
    got = limited(driven(-5), driven(5), 0.05, DriveLimits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], -0.1)


def test_speed_is_the_vectors_length() -> None:
    """3 and 4 m/s are 5, limited to 1 they are 0.6 and 0.8."""
    got = limited(CheckedCommand("twist", (3.0, 4.0, 0.0)), None, 0, DriveLimits(max_speed_m_s=1))
    assert math.dist(got.linear, (0.6, 0.8, 0.0)) < 1e-12

"""Drive messages, read and written anew."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.commands import MAX_NUMBER, SHAPES, Shape, read, write, zero
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

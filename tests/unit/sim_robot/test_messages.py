"""Messages are checked and filled up as rosbridge does."""

from typing import Any

import pytest
from sim_robot.messages import (
    MessageMismatchError,
    MessageTypes,
    TypeUnknownError,
)

NOW_NS = 12_000_000_034


def test_ros_1_knows_the_short_spelling_only() -> None:
    """A ROS 1 robot refuses the ROS 2 name."""
    types = MessageTypes(1)
    assert types.name_of(types.key_of("geometry_msgs/Twist")) == "geometry_msgs/Twist"
    with pytest.raises(TypeUnknownError, match="geometry_msgs/msg/Twist"):
        types.key_of("geometry_msgs/msg/Twist")


@pytest.mark.parametrize(
    ("version", "stamp"),
    [(1, {"secs": 12, "nsecs": 34}), (2, {"sec": 12, "nanosec": 34})],
)
def test_header_gets_the_time(version: int, stamp: dict[str, int]) -> None:
    """A missing header or stamp is the current time, in the words of the ROS version."""
    types = MessageTypes(version)
    for given in ({}, {"header": {"frame_id": "map"}}):
        message = types.conform("geometry_msgs/TwistStamped", given, NOW_NS)
        assert message["header"]["stamp"] == stamp
        assert ("seq" in message["header"]) == (version == 1)


@pytest.mark.parametrize(
    ("key", "values", "where"),
    [
        ("geometry_msgs/Twist", {"linear": {"q": 1}}, "linear.q"),
        ("geometry_msgs/Twist", {"linear": 5}, "linear"),
        ("geometry_msgs/Twist", {"linear": {"x": "1"}}, "linear.x"),
        ("geometry_msgs/Twist", {"linear": {"x": True}}, "linear.x"),
        ("geometry_msgs/Twist", {"linear": {"x": None}}, "linear.x"),
        ("geometry_msgs/PoseWithCovariance", {"covariance": [0.0]}, "covariance"),
        ("geometry_msgs/PoseWithCovariance", {"covariance": ["a"] * 36}, "covariance[0]"),
        ("std_msgs/UInt8", {"data": 256}, "data"),
        ("std_msgs/Int8", {"data": 1.5}, "data"),
        ("std_msgs/String", {"data": 5}, "data"),
        ("std_msgs/Bool", {"data": 1}, "data"),
        ("sensor_msgs/CompressedImage", {"data": "?"}, "data"),
        ("sensor_msgs/CompressedImage", {"data": [256]}, "data"),
        ("sensor_msgs/CompressedImage", {"data": 1.5}, "data"),
        ("std_msgs/Header", {"stamp": 5}, "stamp"),
        ("std_msgs/Header", {"stamp": {"sec": "x"}}, "stamp"),
    ],
)
def test_mismatch_names_the_field(key: str, values: Any, where: str) -> None:
    """What does not fit is refused with the path of the field."""
    with pytest.raises(MessageMismatchError) as caught:
        MessageTypes(2).conform(key, values, NOW_NS)
    assert where in str(caught.value)


def test_bytes_may_be_base64_or_numbers() -> None:
    """uint8[] takes both forms that clients send and keeps base64, which rosbridge sends."""
    types = MessageTypes(2)
    for data in ("AAEC", [0, 1, 2]):
        message = types.conform("sensor_msgs/CompressedImage", {"data": data}, NOW_NS)
        assert message["data"] == "AAEC"

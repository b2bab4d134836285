"""Reads drive commands field by field, limits them, and writes them anew.

Only what was checked is written, so nothing reaches the wheels that this module does not know. Braking is never
limited: no command leaves `limited` faster than it came, and one that asks for less speed than the robot has in that
direction passes at once. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from robotether_common.ros import (
    ACKERMANN,
    ACKERMANN_RATES,
    ACKERMANN_STAMPED,
    AXES,
    TWIST,
    TWIST_STAMPED,
)

from robotether_agent.guard.refused import Refused

Vector = tuple[float, float, float]
Shape = Literal["twist", "twist_stamped", "ackermann"]

STANDSTILL: Vector = (0.0, 0.0, 0.0)
# No robot's; and beyond 3e38 a float32 of ROS is infinite.
MAX_NUMBER = 1e9
MAX_FRAME_ID_LENGTH = 255
SHAPES: Mapping[str, Shape] = {
    "geometry_msgs/Twist": "twist",
    "geometry_msgs/msg/Twist": "twist",
    "geometry_msgs/TwistStamped": "twist_stamped",
    "geometry_msgs/msg/TwistStamped": "twist_stamped",
    "ackermann_msgs/AckermannDriveStamped": "ackermann",
    "ackermann_msgs/msg/AckermannDriveStamped": "ackermann",
}
_MEMBERS: Mapping[Shape, frozenset[str]] = {
    "twist": TWIST,
    "twist_stamped": TWIST_STAMPED,
    "ackermann": ACKERMANN_STAMPED,
}
_STAMP_MEMBERS = frozenset({"secs", "nsecs", "sec", "nanosec"})
MAX_WHOLE = 2**63 - 1
# After a pause the robot may not make up for it at once.
MAX_STEP_S = 0.1


@dataclass(frozen=True)
class CheckedCommand:
    """A checked command in m/s, rad/s and rad. An Ackermann speed is linear[0]; rates are as in its message."""

    shape: Shape
    linear: Vector = STANDSTILL
    angular: Vector = STANDSTILL
    steering: float = 0.0
    rates: Vector = STANDSTILL
    header: Mapping[str, Any] | None = None

    @property
    def moves(self) -> bool:
        """Tell whether the robot is to move; some that steer like cars follow the rates alone."""
        return any(self.linear) or any(self.angular) or any(self.rates)

    @property
    def frame_id(self) -> str:
        """The frame that its header names."""
        return str(self.header.get("frame_id", "")) if self.header else ""


def zero(shape: Shape, frame_id: str = "") -> CheckedCommand:
    """Return the command to stand still."""
    return CheckedCommand(shape, header=None if shape == "twist" else _header_of(frame_id))


def read(message: object, declared: Shape | None) -> CheckedCommand:
    """Return the command in the `msg` of a publish; its shape decides, and `declared` only when it has none."""
    members = _object(message, "msg")
    shape = _shape(members) or declared
    if shape is None:
        raise Refused("shape", "its msg is no Twist, TwistStamped or AckermannDriveStamped")
    _only(members, _MEMBERS[shape], "msg")
    if shape == "twist":
        return _twist(shape, members, None)
    header = _header(members.get("header"))
    if shape == "twist_stamped":
        return _twist(shape, _object(members.get("twist", {}), "twist"), header)
    return _ackermann(_object(members.get("drive", {}), "drive"), header)


def write(command: CheckedCommand) -> dict[str, Any]:
    """Return the `msg` that says what `command` says."""
    if command.shape == "ackermann":
        drive = {"steering_angle": command.steering, "speed": command.linear[0]}
        drive |= dict(zip(ACKERMANN_RATES, command.rates, strict=True))
        return _stamped(command, {"drive": drive})
    twist = {"linear": _written(command.linear), "angular": _written(command.angular)}
    return twist if command.shape == "twist" else _stamped(command, {"twist": twist})


def _shape(members: Mapping[str, Any]) -> Shape | None:
    if "twist" in members:
        return "twist_stamped"
    if "drive" in members:
        return "ackermann"
    return "twist" if "linear" in members or "angular" in members else None


def _twist(
    shape: Shape, members: Mapping[str, Any], header: Mapping[str, Any] | None
) -> CheckedCommand:
    _only(members, _MEMBERS["twist"], "twist")
    linear, angular = _vector(members, "linear"), _vector(members, "angular")
    return CheckedCommand(shape, linear, angular, header=header)


def _ackermann(members: Mapping[str, Any], header: Mapping[str, Any]) -> CheckedCommand:
    _only(members, ACKERMANN, "drive")
    first, second, third = (_number(members, name) for name in ACKERMANN_RATES)
    return CheckedCommand(
        "ackermann",
        (_number(members, "speed"), 0.0, 0.0),
        steering=_number(members, "steering_angle"),
        rates=(first, second, third),
        header=header,
    )


def _header(value: object) -> Mapping[str, Any]:
    header = dict(_object({} if value is None else value, "header"))
    _only(header, frozenset({"seq", "stamp", "frame_id"}), "header")
    frame_id = header.get("frame_id", "")
    # Half a character is not printable, and ROS cannot take it.
    if (
        not isinstance(frame_id, str)
        or len(frame_id) > MAX_FRAME_ID_LENGTH
        or not frame_id.isprintable()
    ):
        raise Refused("shape", "its frame_id is no short printable text")
    stamp = header.get("stamp", {})
    if stamp != "now":
        stamp = _object(stamp, "stamp")
        _only(stamp, _STAMP_MEMBERS, "stamp")
        _whole(stamp)
    _whole({"seq": header.get("seq", 0)})
    return _header_of(frame_id)


def _header_of(frame_id: str) -> Mapping[str, Any]:
    # Neither stamp nor seq: rosbridge writes the robot's own time there. A client's may be of the other ROS,
    # so that the robot does not take a zero, or so far ahead that its controller never calls a command old.
    return {"frame_id": frame_id}


def _whole(members: Mapping[str, Any]) -> None:
    for name, value in members.items():
        if type(value) is not int or not 0 <= value <= MAX_WHOLE:
            raise Refused("shape", f"its {name} is no whole number from 0")


def _vector(members: Mapping[str, Any], name: str) -> Vector:
    axes = _object(members.get(name, {}), name)
    _only(axes, frozenset(AXES), name)
    return (_number(axes, "x"), _number(axes, "y"), _number(axes, "z"))


def _number(members: Mapping[str, Any], name: str) -> float:
    value = members.get(name, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused("shape", f"its {name} is no number")
    # An integer may be too large for a float, so it is compared first.
    if not -MAX_NUMBER <= value <= MAX_NUMBER or not math.isfinite(value):
        raise Refused("shape", f"its {name} is no number that a robot can execute")
    return float(value)


def _object(value: object, name: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise Refused("shape", f"its {name} is no object")
    return value


def _only(members: Mapping[str, Any], known: frozenset[str], name: str) -> None:
    if not members.keys() <= known:
        raise Refused("shape", f"its {name} has members that no drive message has")


def _written(vector: Vector) -> dict[str, float]:
    return dict(zip(AXES, vector, strict=True))


def _stamped(command: CheckedCommand, members: dict[str, Any]) -> dict[str, Any]:
    return {"header": dict(command.header or {}), **members}


@dataclass(frozen=True)
class DriveLimits:
    """None is no limit."""

    max_speed_m_s: float | None = None
    max_turn_rad_s: float | None = None
    max_acceleration_m_s2: float | None = None
    max_turn_acceleration_rad_s2: float | None = None
    max_steering_rad: float | None = None


def limited(
    command: CheckedCommand, before: CheckedCommand | None, step_s: float, limits: DriveLimits
) -> CheckedCommand:
    """Return `command` within `limits`, `step_s` after `before`; None: the robot stands."""
    step_s = min(max(step_s, 0.0), MAX_STEP_S)
    linear, angular = (before.linear, before.angular) if before else (STANDSTILL, STANDSTILL)
    return replace(
        command,
        linear=_limited_vector(
            command.linear, linear, limits.max_speed_m_s, limits.max_acceleration_m_s2, step_s
        ),
        angular=_limited_vector(
            command.angular,
            angular,
            limits.max_turn_rad_s,
            limits.max_turn_acceleration_rad_s2,
            step_s,
        ),
        steering=_limited_scalar(command.steering, limits.max_steering_rad),
    )


def _limited_vector(
    wanted: Vector, before: Vector, most: float | None, growth: float | None, step_s: float
) -> Vector:
    length = math.hypot(*wanted)
    allowed = length if most is None else min(length, most)
    if growth is not None and length > 0:
        allowed = min(allowed, _along(before, wanted, length) + growth * step_s)
    return wanted if allowed >= length else _scaled(wanted, allowed / length)


def _along(before: Vector, wanted: Vector, length: float) -> float:
    """Return how fast the robot is in the wanted direction already; the other way counts as standing."""
    return max(0.0, sum(old * (new / length) for old, new in zip(before, wanted, strict=True)))


def _scaled(vector: Vector, factor: float) -> Vector:
    x, y, z = vector
    return (x * factor, y * factor, z * factor)


def _limited_scalar(value: float, most: float | None) -> float:
    return value if most is None else max(-most, min(most, value))

"""Reads speed and turn of a publish to a drive topic, and stamps it for the guard.

`message_validator` makes one of each such publish that passes; the relay looks at its age and speed and
sends what `stamped` writes. The shape of `msg` tells the type: geometry_msgs/Twist and
TwistStamped, ackermann_msgs/AckermannDriveStamped; a member that is missing is zero, as it is to
rosbridge. What is no drive command must never pass as one. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from robotether_common.guard import STAMP
from robotether_common.ros import ACKERMANN, ACKERMANN_STAMPED, AXES, TWIST, TWIST_STAMPED

from robotether_server.relay.rosbridge.fields import FieldRefusedError

_AXES = frozenset(AXES)
_STAMPED = b'%%b,"%b":{"t_ms":%%.3f,"fence":%%d}}' % STAMP.encode()


class DriveCommand(NamedTuple):
    """A publish to a drive topic that passed; `data` is `message` as it is written."""

    topic: str
    message: Mapping[str, Any]
    data: bytes
    # When the input event was on the relay's clock, as far as the client says.
    stamp_ms: float | None
    speed_m_s: float
    # None: the command says how to steer, not how fast to turn.
    turn_rad_s: float | None


def stamped(command: DriveCommand, t_ms: float, fence: int) -> bytes:
    """Write a command for the guard, with its moment on the robot's clock and the lease's number."""
    return _STAMPED % (command.data[:-1], t_ms, fence)


def speeds(msg: Mapping[str, Any]) -> tuple[float, float | None]:
    """Return the speed in m/s and the turn in rad/s; raise FieldRefusedError when it is no command."""
    members = msg.keys()
    if members <= TWIST:
        return _of_twist(msg)
    if members <= TWIST_STAMPED:
        return _of_twist(_object(msg.get("twist", {}), TWIST))
    if members <= ACKERMANN_STAMPED:
        drive = _object(msg.get("drive", {}), ACKERMANN)
        for value in drive.values():
            _finite(value)
        return abs(_finite(drive.get("speed", 0.0))), None
    raise FieldRefusedError(
        "is neither a Twist, a TwistStamped nor an AckermannDriveStamped, which a drive topic takes"
    )


def _of_twist(twist: Mapping[str, Any]) -> tuple[float, float]:
    return _length(twist.get("linear", {})), _length(twist.get("angular", {}))


def _length(vector: Any) -> float:
    return _finite(math.hypot(*map(_finite, _object(vector, _AXES).values())))


def _object(value: Any, known: frozenset[str]) -> Mapping[str, Any]:
    if not isinstance(value, dict) or not value.keys() <= known:
        raise FieldRefusedError(f"has a part that is no object of {', '.join(sorted(known))}")
    return value


def _finite(value: Any) -> float:
    # True is a number to Python only.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise FieldRefusedError("holds a speed that is no finite number")
    return float(value)

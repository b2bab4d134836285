"""Checks of single fields of a client's message; `OPERATIONS` says which field gets which.

A check returns the value to send on, and raises FieldRefusedError with the reason. What passes has
one meaning to every JSON parser; but for `payload`, which `json_text` looks after, it holds no
object in which a parser that lost its way could find an operation. Pure.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from robotether_common.ros import (
    ACKERMANN,
    ACKERMANN_STAMPED,
    AXES,
    MAX_NAME_LENGTH,
    TWIST,
    TWIST_STAMPED,
    full_name,
)

Check = Callable[[Any], object]

MAX_TEXT_LENGTH = 1024
# Parsers written in C refuse what is longer, or make a float of it.
WHOLE_64_BIT = (-(2**63), 2**63 - 1)
# Whole numbers that are the same as floats.
WHOLE_53_BIT = (-(2.0**53), 2.0**53)
# A field of a ROS message; `op` would make an operation of the object that it stands in.
FIELD_NAME = re.compile(r"(?!op\Z)[A-Za-z][A-Za-z0-9_]{0,63}")
_AXES = frozenset(AXES)


class FieldRefusedError(ValueError):
    """A field may not go on; the text goes on where its name ends: "is ..."."""


def text(value: Any) -> str:
    """Pass a text of bounded length."""
    if not isinstance(value, str) or len(value) > MAX_TEXT_LENGTH:
        raise FieldRefusedError(f"is no text of up to {MAX_TEXT_LENGTH} characters")
    try:
        value.encode()
    except UnicodeEncodeError as exc:
        raise FieldRefusedError("is no Unicode: it holds half of a character") from exc
    return value


def ros_name(value: Any) -> str:
    """Pass the name of a topic, service or action, with the first slash that it may lack."""
    name = full_name(value)
    if name is None:
        raise FieldRefusedError(
            f"is no full name such as /a/b_1, of up to {MAX_NAME_LENGTH} characters"
        )
    return name


def flag(value: Any) -> bool:
    """Pass a truth value."""
    if not isinstance(value, bool):
        raise FieldRefusedError("is neither true nor false")
    return value


def whole(low: int, high: int) -> Check:
    """Make a check for whole numbers from `low` to `high`."""

    def check(value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise FieldRefusedError(f"is no whole number from {low} to {high}")
        return value

    return check


def number(low: float, high: float) -> Check:
    """Make a check for numbers from `low` to `high`."""

    def check(value: Any) -> float:
        fits = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not fits or not low <= value <= high:
            raise FieldRefusedError(f"is no number from {low:g} to {high:g}")
        return float(value)

    return check


def choice(*allowed: str) -> Check:
    """Make a check for one of some words."""

    def check(value: Any) -> str:
        for word in allowed:
            if value == word:
                return word
        raise FieldRefusedError(f"is none of {', '.join(allowed)}")

    return check


def identity(value: Any) -> str | int:
    """Pass what an answer refers to: a text or a whole number."""
    if isinstance(value, str):
        return text(value)
    return _whole_64_bit(value)


def members(value: Any) -> dict[str, Any]:
    """Pass an object of any members: a message."""
    if not isinstance(value, dict):
        raise FieldRefusedError("is no object")
    return value


def payload(value: Any) -> dict[str, Any] | list[Any]:
    """Pass an object or array of anything: what a service or an action takes."""
    if not isinstance(value, (dict, list)):
        raise FieldRefusedError("is neither object nor array")
    return value


def timestamp(value: Any) -> float:
    """Pass a time in ms."""
    low, high = WHOLE_53_BIT
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not low <= value <= high:
        raise FieldRefusedError("is no time in ms")
    return float(value)


def stamp(value: Any) -> float:
    """Return the moment of a drive command, out of the object that stands beside `msg`."""
    if not isinstance(value, dict) or "t_ms" not in value:
        raise FieldRefusedError("is no object with t_ms")
    return timestamp(value["t_ms"])


def scalars(value: Any) -> dict[str, object] | list[object]:
    """Pass an object or array of texts, numbers and truth values; nothing stands deeper."""
    if isinstance(value, list):
        return [_scalar(item) for item in value]
    if not isinstance(value, dict):
        raise FieldRefusedError("is neither object nor array")
    for name in value:
        if not FIELD_NAME.fullmatch(name):
            raise FieldRefusedError(f"has a member {name[:64]!r}, which may not stand here")
    return {name: _scalar(item) for name, item in value.items()}


def _scalar(value: Any) -> object:
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return text(value)
    if isinstance(value, float) and math.isfinite(value):
        return value
    return _whole_64_bit(value)


def _whole_64_bit(value: Any) -> int:
    low, high = WHOLE_64_BIT
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise FieldRefusedError("holds what is neither a text nor a number of 64 bits")
    return value


def speeds(msg: Mapping[str, Any]) -> tuple[float, float | None]:
    """Return the speed in m/s and the turn in rad/s; raise FieldRefusedError when it is no command.

    The shape tells the type: geometry_msgs/Twist and TwistStamped, ackermann_msgs/AckermannDriveStamped. A member
    that is missing is zero, as it is to rosbridge.
    """
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

"""Drive commands as numbers with names, by the messages of ROS that drive a robot. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import msgspec
from robotether_common.ros import ACKERMANN_RATES, AXES

MAX_FLOAT32 = 3.4e38
Path = tuple[str, ...]
_TWIST: tuple[Path, ...] = tuple((part, axis) for part in ("linear", "angular") for axis in AXES)
# The numbers of each kind of command: where they are in its message.
KINDS: Mapping[str, tuple[Path, ...]] = {
    "twist": _TWIST,
    "twist stamped": tuple(("twist", *path) for path in _TWIST),
    "ackermann stamped": tuple(
        ("drive", name) for name in ("steering_angle", "speed", *ACKERMANN_RATES)
    ),
}


class Action(NamedTuple):
    """A command: its kind, and its numbers in the order of `action_names`."""

    kind: str
    values: tuple[float, ...]


def action_names(kind: str) -> list[str]:
    """Return the names of a command's numbers, without the member that holds them all."""
    return [".".join(path[-2:] if kind.startswith("twist") else path[-1:]) for path in KINDS[kind]]


def action_of(text: str) -> Action | None:
    """Return what a message in JSON commands; None for none of these messages. A missing member is 0, as in ROS."""
    try:
        message = msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError):
        return None
    if not isinstance(message, dict):
        return None
    kind = (
        "twist stamped"
        if "twist" in message
        else "ackermann stamped"
        if "drive" in message
        else "twist"
    )
    try:
        values = tuple(_number(message, path) for path in KINDS[kind])
    except (TypeError, OverflowError):
        return None
    return Action(kind, values) if are_float32(values) else None


def are_float32(values: Iterable[float]) -> bool:
    """Return whether all can be written as float32, none of them NaN or infinite."""
    return all(abs(value) <= MAX_FLOAT32 for value in values)


def _number(message: Mapping[str, Any], path: Path) -> float:
    value: Any = message
    for name in path[:-1]:
        value = value.get(name, {}) if isinstance(value, dict) else None
    if not isinstance(value, dict):
        raise TypeError
    value = value.get(path[-1], 0.0)
    if not isinstance(value, int | float):
        raise TypeError
    return float(value)

"""Typed getters for the members of a robot's settings; every refusal names the member by its path.

Used by robot_settings and its parts. A value passes as it is meant or not at all. Pure.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, TypeVar

from robotether_server.globs import MAX_GLOB_LENGTH, Globs, is_glob
from robotether_server.problems import FieldInvalid

T = TypeVar("T", bound=str)

MAX_GLOBS = 64
MAX_ROS_NAME_LENGTH = 255
# As the relay takes names in messages (relay/rosbridge/fields.py), with their first `/`.
ROS_NAME = re.compile(r"(?:/[A-Za-z0-9_]+)+")


class Bounds(NamedTuple):
    """The lowest and the highest value that a number may have."""

    low: float
    high: float


def members(given: object, path: str, known: Collection[str]) -> Mapping[str, object]:
    """Return an object that has no other members than `known`."""
    if not isinstance(given, Mapping):
        raise FieldInvalid(f"cannot use {path}: it must be an object with members")
    for name in given:
        if name not in known:
            raise FieldInvalid(
                f"cannot use {path}: {str(name)[:40]!r} is no setting; there is {', '.join(known)}"
            )
    return given


def listed(given: object, path: str, most: int, of: str) -> Sequence[object]:
    """Return a list of at most so many; `of` names in the plural what is in it, for the refusal."""
    if not isinstance(given, list | tuple) or len(given) > most:
        raise FieldInvalid(f"cannot use {path}: it must be a list of at most {most} {of}")
    return given


def globs(given: object, path: str) -> Globs:
    """Return patterns for names."""
    patterns: list[str] = []
    for pattern in listed(given, path, MAX_GLOBS, "names"):
        if not isinstance(pattern, str) or not is_glob(pattern):
            raise FieldInvalid(
                f"cannot use {path}: {str(pattern)[:40]!r} is no full name, such as /arm/move or */cmd_vel; a "
                f"name begins with / or *, has a-z, A-Z, 0-9, _, / and * and at most {MAX_GLOB_LENGTH} characters"
            )
        patterns.append(pattern)
    return Globs(dict.fromkeys(patterns))


def whole(given: object, path: str, bounds: Bounds, instead: str = "") -> int:
    """Return a whole number within the bounds, both included; `instead` as for `number`."""
    value = _plain_number(given)
    if value is None or value != math.floor(value) or not bounds.low <= value <= bounds.high:
        raise FieldInvalid(
            f"cannot use {path}: it must be {instead}a whole number from {bounds.low:g} to {bounds.high:g}"
        )
    return int(value)


def number(given: object, path: str, bounds: Bounds, instead: str = "") -> float:
    """Return a number within the bounds. `instead`: what else the caller takes, for the refusal."""
    value = _plain_number(given)
    if value is None or not bounds.low <= value <= bounds.high:
        raise FieldInvalid(
            f"cannot use {path}: it must be {instead}a number from {bounds.low:g} to {bounds.high:g}"
        )
    return float(value)


def choice(given: object, path: str, allowed: Collection[T]) -> T:
    """Return one of the allowed texts."""
    for value in allowed:
        if given == value:
            return value
    raise FieldInvalid(f"cannot use {path}: it must be one of {', '.join(allowed)}")


def flag(given: object, path: str) -> bool:
    """Return true or false."""
    if not isinstance(given, bool):
        raise FieldInvalid(f"cannot use {path}: it must be true or false")
    return given


def label(given: object, path: str, longest: int) -> str:
    """Return a text for people, without white space around it."""
    text = given.strip() if isinstance(given, str) and len(given) <= longest else ""
    if not text or not text.isprintable():
        raise FieldInvalid(
            f"cannot use {path}: it must be a text of 1 to {longest} printable characters"
        )
    return text


def ros_name(given: object, path: str) -> str:
    """Return the full name of a topic or service."""
    if (
        not isinstance(given, str)
        or len(given) > MAX_ROS_NAME_LENGTH
        or not ROS_NAME.fullmatch(given)
    ):
        raise FieldInvalid(
            f"cannot use {path}: it must be a full name such as /arm/move_1, of a-z, A-Z, 0-9, _ and /, and at "
            f"most {MAX_ROS_NAME_LENGTH} characters"
        )
    return given


def _plain_number(given: object) -> int | float | None:
    # True and False are numbers to Python, and not to JSON; so are NaN and infinity.
    if isinstance(given, bool) or not isinstance(given, int | float):
        return None
    return given if isinstance(given, int) or math.isfinite(given) else None

"""Reads JSON as a robot's rosbridge writes it: as Python does, with NaN and Infinity for numbers that JSON lacks.

What a client sends is read by `relay/channels/rosbridge/operations.py` alone, which refuses them. Pure.
"""

from __future__ import annotations

import re
from typing import TypeVar

import msgspec

T = TypeVar("T")

# A text without an end is taken up to the end, so that the time grows with the length and no faster.
_TEXT_OR_NO_NUMBER = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"?|-?\bInfinity\b|\bNaN\b', re.DOTALL)


def without_nan(data: bytes) -> bytes:
    """Return the message with null, as rosbridge also writes, for each number that is NaN or infinite."""
    if b"NaN" not in data and b"Infinity" not in data:
        return data
    return _TEXT_OR_NO_NUMBER.sub(lambda part: part[0] if part[0][:1] == b'"' else b"null", data)


def read_robot_json(data: bytes, type_: type[T]) -> T:
    """Return what the message holds, with null for such numbers; raise msgspec.DecodeError or RecursionError."""
    try:
        return msgspec.json.decode(data, type=type_)
    except msgspec.DecodeError:
        return msgspec.json.decode(without_nan(data), type=type_)

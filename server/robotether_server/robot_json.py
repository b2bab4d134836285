"""Reads JSON as a robot's rosbridge writes it: as Python does, with NaN and Infinity for numbers that JSON lacks.

What a client sends is read by `relay/channels/rosbridge/operations.py` alone, which refuses them. Pure.
"""

from __future__ import annotations

import json
from typing import TypeVar

import msgspec

T = TypeVar("T")

# Maximum size of a message that is written anew, which takes some 20 ms: drivers wait meanwhile.
MAX_BYTES = 256 * 1024


def without_nan(data: bytes) -> bytes:
    """Return the message with null, as rosbridge also writes, for each number that is NaN or infinite.

    One without such numbers, over MAX_BYTES or in any other way no JSON stays as it is.
    """
    if len(data) > MAX_BYTES or (b"NaN" not in data and b"Infinity" not in data):
        return data
    constants: list[str] = []
    try:
        message = json.loads(data, parse_constant=constants.append)
        return msgspec.json.encode(message) if constants else data
    except (ValueError, OverflowError, RecursionError):
        return data


def read_robot_json(data: bytes, type_: type[T]) -> T:
    """Return what the message holds, with null for such numbers; raise msgspec.DecodeError or RecursionError."""
    try:
        return msgspec.json.decode(data, type=type_)
    except msgspec.DecodeError:
        finite = without_nan(data)
        if finite is data:
            raise
        return msgspec.json.decode(finite, type=type_)

"""Reads JSON from clients strictly, and writes it so that every parser reads it alike.

`message_validator` reads a client's message here, and sends what this writes in its place. Some robots'
parsers refuse what Python's takes (deep nesting, NaN, numbers over 64 bits, half characters), and
rosbridge, when it cannot parse a message as a whole, runs any object with an `op` that it finds
inside. So nothing that a parser may refuse is ever written. Pure.
"""

from __future__ import annotations

import json
from typing import Any, NoReturn

# Messages of ROS nest less than ten deep.
MAX_DEPTH = 64
# What signed and unsigned integers of ROS hold.
MIN_INTEGER, MAX_INTEGER = -(2**63), 2**64 - 1
MAX_DIGITS = 40

# A number of fewer digits is within 64 bits, so that its digits need no look of their own.
_MANY_DIGITS = b"0" * 19
_DIGITS = bytes(ord("0") if byte in b"0123456789" else 0 for byte in range(256))


class NotJsonError(ValueError):
    """A message is no JSON object, or none that all parsers read alike; the text says why."""


def read(data: bytes) -> dict[str, Any]:
    """Return the one JSON object in UTF-8 that the message is; raise NotJsonError."""
    try:
        text = data.decode()
        decoder = _CAREFUL if _MANY_DIGITS in data.translate(_DIGITS) else _QUICK
        message = decoder.decode(text)
    except UnicodeDecodeError as exc:
        raise NotJsonError("it is not UTF-8") from exc
    except RecursionError as exc:
        raise NotJsonError("it is nested too deep") from exc
    except NotJsonError:
        raise
    except ValueError as exc:
        raise NotJsonError(str(exc)) from exc
    if not isinstance(message, dict):
        raise NotJsonError("it is no object")
    # Fewer brackets than that cannot nest deeper.
    if data.count(b"{") + data.count(b"[") > MAX_DEPTH:
        _check_depth(message)
    return message


def write(message: dict[str, Any]) -> bytes:
    """Return the message as JSON in UTF-8; raise NotJsonError for what JSON or UTF-8 cannot hold."""
    try:
        return _ENCODER.encode(message).encode()
    except UnicodeEncodeError as exc:
        raise NotJsonError("it holds half of a character") from exc
    except ValueError as exc:
        raise NotJsonError("a number in it is too large") from exc


def _check_depth(message: dict[str, Any]) -> None:
    level: list[Any] = [message]
    for _ in range(MAX_DEPTH):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, (dict, list))
        ]
        if not level:
            return
    raise NotJsonError(f"it is nested more than {MAX_DEPTH} deep")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        raise NotJsonError("a key appears twice")
    return result


def _no_constant(name: str) -> NoReturn:
    raise NotJsonError(f"{name} is no number of JSON")


def _whole(digits: str) -> int:
    number = int(digits) if len(digits) <= MAX_DIGITS else MAX_INTEGER + 1
    if not MIN_INTEGER <= number <= MAX_INTEGER:
        raise NotJsonError("a number in it has more than 64 bits")
    return number


_QUICK = json.JSONDecoder(object_pairs_hook=_unique_keys, parse_constant=_no_constant)
_CAREFUL = json.JSONDecoder(
    object_pairs_hook=_unique_keys, parse_constant=_no_constant, parse_int=_whole
)
_ENCODER = json.JSONEncoder(
    separators=(",", ":"), allow_nan=False, ensure_ascii=False, check_circular=False
)

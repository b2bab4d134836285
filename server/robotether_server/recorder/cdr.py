"""Writes messages that rosbridge sends as JSON in CDR, ROS 2's own encoding, which all tools for files of it read.

A number that JSON cannot hold comes as null and becomes NaN. An encoder is made once for each type. Pure.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotether_common.ros import octet_of

from robotether_server.contract.recordings import CDR_START
from robotether_server.problems import RobotetherError
from robotether_server.recorder.ros_types import RosField, RosType

NAN = float("nan")
FORMATS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
OCTETS = frozenset(["byte", "char", "int8", "uint8"])
# What ROS 1 calls the members of a time.
STAMP_MEMBERS = {"sec": "secs", "nanosec": "nsecs"}
COUNT = struct.Struct("<I")

Write = Callable[[bytearray, Any], None]
Encoder = Callable[[Mapping[str, Any]], bytes]


class EncodingError(RobotetherError):
    """A message is not of its type."""


def encoder_of(ros_type: RosType) -> Encoder:
    """Return what writes messages of a type; it raises EncodingError."""
    write = _Writers(ros_type).of(ros_type.name)

    def encode(message: Mapping[str, Any]) -> bytes:
        data = bytearray(CDR_START)
        try:
            write(data, message)
        except (
            struct.error,
            TypeError,
            ValueError,
            KeyError,
            AttributeError,
            OverflowError,
        ) as exc:
            raise EncodingError(f"no {ros_type.full_name}: {exc}") from exc
        return bytes(data)

    return encode


class _Writers:
    """What writes each type of one message type."""

    def __init__(self, ros_type: RosType) -> None:
        self._types = ros_type.types
        self._writers: dict[str, Write] = {"string": _write_string}

    def of(self, name: str) -> Write:
        """Return what writes one value of a type."""
        if name not in self._writers:
            self._writers[name] = (
                _number(name) if name in FORMATS else self._message(self._types[name])
            )
        return self._writers[name]

    def _message(self, fields: Sequence[RosField]) -> Write:
        members = [
            (field.name, STAMP_MEMBERS.get(field.name), self._field(field)) for field in fields
        ]

        def write(data: bytearray, value: Any) -> None:
            for name, other_name, write_member in members:
                if name in value or other_name is None:
                    write_member(data, value[name])
                else:
                    write_member(data, value[other_name])
            if not members:
                # A structure has at least one member.
                data.append(0)

        return write

    def _field(self, field: RosField) -> Write:
        if field.length is None:
            return self.of(field.type)
        if field.type in FORMATS:
            return _numbers(field.type, field.length)
        write_one, length = self.of(field.type), field.length

        def write(data: bytearray, values: Any) -> None:
            _check_length(values, length)
            if not length:
                _write_count(data, len(values))
            for value in values:
                write_one(data, value)

        return write


def _number(name: str) -> Write:
    number = struct.Struct(f"<{FORMATS[name]}")
    read = _reader(name)

    def write(data: bytearray, value: Any) -> None:
        _align(data, number.size)
        data += number.pack(read(value))

    return write


def _numbers(name: str, length: int) -> Write:
    letter, read = FORMATS[name], _reader(name)
    size = struct.calcsize(letter)

    def write(data: bytearray, values: Any) -> None:
        if isinstance(values, str) and name in OCTETS:
            # How rosbridge writes bytes.
            values = _decoded(values)
        _check_length(values, length)
        if not length:
            _write_count(data, len(values))
        if not values:
            return
        _align(data, size)
        if isinstance(values, bytes):
            data += values
            return
        data += struct.pack(f"<{len(values)}{letter}", *map(read, values))

    return write


def _reader(name: str) -> Callable[[Any], Any]:
    """Return what reads a number of JSON; struct refuses what else is none."""
    if name == "bool":
        return _read_bool
    if name.startswith("float"):
        return lambda value: NAN if value is None else value
    if name in OCTETS:
        return lambda value: octet_of(value) if isinstance(value, str) else value
    return lambda value: value


def _read_bool(value: Any) -> Any:
    # struct takes null for false, and a text for true.
    if value not in (0, 1):
        raise ValueError(f"{value!r:.20} in place of a bool")
    return value


def _write_string(data: bytearray, value: Any) -> None:
    text = value.encode()
    _write_count(data, len(text) + 1)
    data += text
    data.append(0)


def _write_count(data: bytearray, count: int) -> None:
    _align(data, COUNT.size)
    data += COUNT.pack(count)


def _align(data: bytearray, size: int) -> None:
    data += bytes(-(len(data) - len(CDR_START)) % size)


def _decoded(text: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except binascii.Error as exc:
        raise ValueError("bytes that are no base64") from exc


def _check_length(values: Any, length: int) -> None:
    if length and len(values) != length:
        raise ValueError(f"{len(values)} values in place of {length}")

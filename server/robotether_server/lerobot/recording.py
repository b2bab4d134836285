"""Reads what of a recording becomes training data: commands, who drives, odometry, and the frames of cameras.

The layout of the messages is that of `recorder/channels.py`.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

from robotether_server.contract.recordings import (
    IMAGE_SUFFIX,
    MAGIC,
    NAMESPACE,
    RECORD,
    VIDEO_SUFFIX,
)
from robotether_server.lerobot.actions import Action, action_of
from robotether_server.lerobot.cdr_reader import CdrReader, DecodingError
from robotether_server.problems import RobotetherError

# Maximum size of a record: a chunk has at most a megabyte and a frame.
MAX_RECORD_BYTES = 32 * 1024 * 1024
# Maximum number of messages of a recording that are kept in memory.
MAX_MESSAGES = 4_000_000

COMMANDS, CONTROL = f"{NAMESPACE}commands", f"{NAMESPACE}control"
# Ending of a camera's topic, by the type of its messages.
CAMERA_SUFFIXES = {
    "sensor_msgs/msg/CompressedImage": IMAGE_SUFFIX,
    "foxglove_msgs/msg/CompressedVideo": VIDEO_SUFFIX,
}
_XYZ = ("x", "y", "z")
# Names of what odometry says, by the type of its messages; of the first type that a recording has is its state.
STATE_NAMES: Mapping[str, tuple[str, ...]] = {
    "nav_msgs/msg/Odometry": (
        *(f"position.{axis}" for axis in _XYZ),
        *(f"orientation.{axis}" for axis in (*_XYZ, "w")),
        *(f"linear.{axis}" for axis in _XYZ),
        *(f"angular.{axis}" for axis in _XYZ),
    ),
    "turtlesim/msg/Pose": ("x", "y", "theta", "linear_velocity", "angular_velocity"),
}
# Of each type, the usual name in the robot's namespace.
USUAL_TOPICS = {"nav_msgs/msg/Odometry": ("odom",), "turtlesim/msg/Pose": ("pose",)}
COVARIANCES = 36


class NotExportedError(RobotetherError, code="not_exported"):
    """A recording cannot become training data."""


class RecordedFrame(NamedTuple):
    """A frame of a camera as it came. `taken_ns` is the robot's word, `log_ns` the recorder's."""

    camera: str
    codec: str
    data: bytes
    sequence: int
    taken_ns: int
    log_ns: int


class RecordedCommand(NamedTuple):
    """A drive command. `action` None: nobody can read it; `seen`: by camera the number of a frame, -1 for unknown."""

    at_ns: int
    fence: int
    is_sent: bool
    action: Action | None
    seen: tuple[tuple[str, int], ...]
    topic: str = ""


class RecordedControl(NamedTuple):
    """Who has control from a time on; with a negative fence that is unknown."""

    at_ns: int
    is_driven: bool
    fence: int
    is_stopped: bool


class RecordedState(NamedTuple):
    """What odometry says; `kind` is the type of its message."""

    at_ns: int
    topic: str
    kind: str
    values: tuple[float, ...]


Recorded = RecordedFrame | RecordedCommand | RecordedControl | RecordedState


def read_recording(path: Path) -> Iterator[Recorded]:
    """Yield what is in a file, in its order; a message that is not of its type is left out. Raise NotExportedError."""
    readers: dict[int, _Reader | None] = {}
    schemas: dict[int, str] = {}
    for record in _mcap_records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            readers[record.id] = _reader_of(record.topic, schemas.get(record.schema_id, ""))
        elif isinstance(record, Message) and (read := readers.get(record.channel_id)) is not None:
            try:
                yield read(CdrReader(record.data), record)
            except DecodingError:
                continue


_Reader = Callable[[CdrReader, Message], Recorded]


def _reader_of(topic: str, kind: str) -> _Reader | None:
    if topic == COMMANDS:
        return _command
    if topic == CONTROL:
        return _control
    if kind in STATE_NAMES:
        return lambda fields, message: RecordedState(
            message.log_time, topic, kind, tuple(_state_values(fields, kind))
        )
    suffix = CAMERA_SUFFIXES.get(kind)
    if suffix is None or not topic.endswith(suffix):
        return None
    read, camera = _image if suffix == IMAGE_SUFFIX else _video, topic.removesuffix(suffix)
    return lambda fields, message: RecordedFrame(
        camera, *read(fields), message.sequence, message.publish_time, message.log_time
    )


def _command(fields: CdrReader, _message: Message) -> RecordedCommand:
    at_ns = fields.time_ns()
    topic = fields.text()
    fields.text()  # person
    fence = fields.whole()
    fields.number("d")  # age
    is_sent = fields.text() == "sent"
    fields.skip("d", 2)  # speeds
    action = action_of(fields.text())
    cameras = fields.texts()
    seen = tuple(zip(cameras, fields.wholes(), strict=False))
    return RecordedCommand(at_ns, fence, is_sent, action, seen, topic)


def _control(fields: CdrReader, message: Message) -> RecordedControl:
    fields.time_ns()
    is_online, driver = bool(fields.number("?")), fields.text()
    fence, is_stopped = fields.whole(), bool(fields.number("?"))
    # The first of a file is older than that: it says what was the case before.
    return RecordedControl(message.log_time, is_online and bool(driver), fence, is_stopped)


def _state_values(fields: CdrReader, kind: str) -> Iterator[float]:
    if kind == "turtlesim/msg/Pose":
        yield from (fields.number("f") for _ in STATE_NAMES[kind])
        return
    fields.time_ns()
    fields.text()  # frame
    fields.text()  # child's frame
    yield from (fields.number("d") for _ in range(7))
    fields.skip("d", COVARIANCES)
    yield from (fields.number("d") for _ in range(6))


def _image(fields: CdrReader) -> tuple[str, bytes]:
    fields.time_ns()
    fields.text()  # frame
    return fields.text(), fields.octets()


def _video(fields: CdrReader) -> tuple[str, bytes]:
    fields.time_ns()
    fields.text()  # frame
    data = fields.octets()
    return fields.text(), data


def _mcap_records(path: Path) -> Iterator[Schema | Channel | Message]:
    """Yield the records of a file, which may say anything of their sizes."""
    try:
        with path.open("rb") as file:
            for chunk in _chunks(file, path):
                for record in breakup_chunk(chunk, validate_crc=True):
                    if isinstance(record, Schema | Channel | Message):
                        yield record
    except OSError as exc:
        raise NotExportedError(f"cannot read {path}: {exc.strerror}") from exc
    except (McapError, struct.error, UnicodeDecodeError, ValueError) as exc:
        raise NotExportedError(f"cannot export {path}: the file is damaged") from exc


def _chunks(file: BinaryIO, path: Path) -> Iterator[Chunk]:
    if file.read(len(MAGIC)) != MAGIC:
        raise NotExportedError(f"cannot export {path}: it is not a recording (MCAP)")
    size = os.fstat(file.fileno()).st_size
    while True:
        head = file.read(RECORD.size)
        opcode, length = RECORD.unpack(head) if len(head) == RECORD.size else (0, size)
        if length > size - file.tell():
            raise NotExportedError(
                f"cannot export {path}: it has no end; download it again after the recording ended"
            )
        if length > MAX_RECORD_BYTES:
            raise NotExportedError(
                f"cannot export {path}: a part of it is larger than a recorder writes"
            )
        body = file.read(length)
        if opcode == Opcode.DATA_END:
            return
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            if chunk.compression:
                raise NotExportedError(
                    f"cannot export {path}: it is compressed, as no recorder of ours writes"
                )
            yield chunk

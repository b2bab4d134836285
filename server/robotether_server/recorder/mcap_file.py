"""Writes an MCAP file that a killed process leaves readable, and makes such a file whole again.

Messages wait in a chunk until `end_chunk` hands them to the kernel, which keeps them when this process is killed. The
package mcap writes a chunk by its size alone, so what a file consists of is written here, and its index by that
package. Nothing is compressed: frames are already, and a reader finds each message by a range of bytes.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Schema,
    Statistics,
)

from robotether_server.contract.recordings import MAGIC, RECORD

PROFILE = "ros2"
# Of a message: channel, sequence, and the times of its log and of its publication in ns.
MESSAGE = struct.Struct("<HIQQ")
# Of a chunk: first and last time in ns, size, CRC; the length of no compression; the size of what follows.
CHUNK = struct.Struct("<QQQIIQ")
# What writing to a full disk, or beyond a quota or a limit, fails with.
FULL = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
# Size of messages after which a chunk ends before its time.
MAX_CHUNK_BYTES = 1024 * 1024
# Maximum number of channels, which are held in memory with their types; a robot may have new topics all the time.
MAX_CHANNELS = 200


class RecordedChannel(NamedTuple):
    """A topic of a file: its name, its message type, and that type's definition as `ros2msg`."""

    topic: str
    type: str
    definition: str


class RecordedMessage(NamedTuple):
    """A message in CDR with the times of its log and of its publication in ns of Unix."""

    channel: RecordedChannel
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass
class FileIndex:
    """What the end of a file says of what is in it."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)

    @property
    def start_ns(self) -> int:
        """The first time of a message, 0 without messages."""
        return min((chunk.message_start_time for chunk in self.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """The last time of a message, 0 without messages."""
        return max((chunk.message_end_time for chunk in self.chunks), default=0)

    def add(self, record: McapRecord) -> None:
        """Take over a schema or a channel."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record

    def written(self, summary_start: int) -> bytes:
        """Return the end of the file, which begins at `summary_start` behind the record that ends the data."""
        builder = RecordBuilder()
        for record in (*self.schemas.values(), *self.channels.values()):
            record.write(builder)
        self._statistics().write(builder)
        for chunk in self.chunks:
            chunk.write(builder)
        summary = _taken(builder)
        # The footer's own beginning counts, too: opcode, length, and both positions.
        crc = zlib.crc32(summary + struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, 0))
        Footer(summary_start, 0, crc).write(builder)
        return summary + _taken(builder) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=0,
            schema_count=len(self.schemas),
        )


@dataclass
class _Chunk:
    """The messages that are not written yet."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    start_ns: int = 0
    end_ns: int = 0
    # By channel: the time and the position of each message.
    positions: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def add(self, *parts: bytes) -> None:
        """Add a record."""
        self.parts += parts
        self.size += sum(map(len, parts))

    def note_message(self, channel: int, log_ns: int) -> None:
        """A message of this time comes next."""
        self.start_ns = min(self.start_ns, log_ns) if self.positions else log_ns
        self.end_ns = max(self.end_ns, log_ns)
        self.positions.setdefault(channel, []).append((log_ns, self.size))

    def header(self) -> bytes:
        """Return what comes before its records."""
        crc = 0
        for part in self.parts:
            crc = zlib.crc32(part, crc)
        length = CHUNK.size + self.size
        fields = CHUNK.pack(self.start_ns, self.end_ns, self.size, crc, 0, self.size)
        return RECORD.pack(Opcode.CHUNK, length) + fields


class McapFile:
    """A file under way. Every method but `add` writes, and raises OSError, as when the disk is full."""

    def __init__(self, path: Path) -> None:
        # Without a buffer of its own, which would fail again when the file is closed.
        self._file = path.open("xb", buffering=0)
        self._index = FileIndex()
        self._channels: dict[RecordedChannel, int] = {}
        self._chunk = _Chunk()
        # The number of messages of each channel, chunk by chunk.
        self._counts: list[Mapping[int, int]] = []
        # Up to here the file is whole.
        self.size = 0
        self._write(_beginning())

    @property
    def messages(self) -> int:
        """The number of messages, those not written included."""
        waiting = sum(map(len, self._chunk.positions.values()))
        return self._index.counts.total() + waiting

    @property
    def is_full(self) -> bool:
        """Whether the messages that wait are enough for a chunk."""
        return self._chunk.size >= MAX_CHUNK_BYTES

    def has_room_for(self, channel: RecordedChannel) -> bool:
        """Whether a channel is in the file, or may be."""
        return channel in self._channels or len(self._channels) < MAX_CHANNELS

    def add(self, message: RecordedMessage) -> None:
        """Add a message, which `end_chunk` writes."""
        channel = self._channels.get(message.channel) or self._register(message.channel)
        chunk, data = self._chunk, message.data
        chunk.note_message(channel, message.log_ns)
        head = MESSAGE.pack(
            channel, message.sequence % 2**32, max(message.log_ns, 0), max(message.publish_ns, 0)
        )
        chunk.add(RECORD.pack(Opcode.MESSAGE, len(head) + len(data)), head, data)

    def end_chunk(self) -> None:
        """Hand what waits to the kernel."""
        chunk, self._chunk = self._chunk, _Chunk()
        if not chunk.parts:
            return
        start = self.size
        header = chunk.header()
        indexes, index = _index_of(chunk, start, len(header) + chunk.size)
        self._write(b"".join((header, *chunk.parts, indexes)))
        self._index.chunks.append(index)
        self._counts.append({number: len(each) for number, each in chunk.positions.items()})
        self._index.counts.update(self._counts[-1])

    def finish(self) -> None:
        """Write what waits, and the index, and close the file, whatever happens.

        On a full disk the last messages make room for the index.
        """
        try:
            try:
                self.end_chunk()
            finally:
                self._write_end()
        finally:
            self._file.close()

    def _write_end(self) -> None:
        end = _end(self._index, self.size)
        try:
            self._write(end)
        except OSError as error:
            if error.errno not in FULL:
                raise
            self._drop_last(len(end))
            self._write(_end(self._index, self.size))

    def _drop_last(self, size: int) -> None:
        """Take as many of the last chunks away as have this size together."""
        before = self.size
        while self._index.chunks and before - self.size < size:
            chunk = self._index.chunks.pop()
            self.size = chunk.chunk_start_offset
            self._index.counts.subtract(self._counts.pop())
        self._file.seek(self.size)
        self._file.truncate()

    def close(self) -> None:
        """Leave the file as a killed process would."""
        self._file.close()

    def _register(self, channel: RecordedChannel) -> int:
        # One name may have had another definition before.
        data = channel.definition.encode()
        schemas = {(schema.name, schema.data): schema.id for schema in self._index.schemas.values()}
        schema_id = schemas.get((channel.type, data))
        if schema_id is None:
            schema_id = len(schemas) + 1
            self._note(Schema(schema_id, data, "ros2msg", channel.type))
        number = self._channels[channel] = len(self._channels) + 1
        self._note(Channel(number, channel.topic, "cdr", {}, schema_id))
        return number

    def _note(self, record: McapRecord) -> None:
        self._index.add(record)
        builder = RecordBuilder()
        record.write(builder)
        self._chunk.add(_taken(builder))

    def _write(self, data: bytes) -> None:
        """Write all or nothing: what a full disk took of it goes again."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.seek(self.size)
            self._file.truncate()
            raise
        self.size += len(data)


def _index_of(chunk: _Chunk, start: int, length: int) -> tuple[bytes, ChunkIndex]:
    """Return what comes behind a chunk at `start`, and its line in the file's index."""
    builder = RecordBuilder()
    offsets = {}
    for channel, positions in chunk.positions.items():
        offsets[channel] = start + length + builder.count
        MessageIndex(channel, positions).write(builder)
    indexes = _taken(builder)
    index = ChunkIndex(
        chunk_length=length,
        chunk_start_offset=start,
        compression="",
        compressed_size=chunk.size,
        message_end_time=chunk.end_ns,
        message_index_length=len(indexes),
        message_index_offsets=offsets,
        message_start_time=chunk.start_ns,
        uncompressed_size=chunk.size,
    )
    return indexes, index


def _taken(builder: RecordBuilder) -> bytes:
    """Take what was written."""
    return bytes(builder.end())  # type: ignore[no-untyped-call] # of the package


def _beginning() -> bytes:
    builder = RecordBuilder()
    Header(PROFILE, "robotether").write(builder)
    return MAGIC + _taken(builder)


def _end(index: FileIndex, size: int) -> bytes:
    builder = RecordBuilder()
    DataEnd(0).write(builder)
    end = _taken(builder)
    return end + index.written(size + len(end))


def repair(path: Path) -> FileIndex | None:
    """Make the file of a killed recorder whole; return what is in it, None if it is none of a recorder.

    What was not written as a whole goes; that is less than a chunk. Raises OSError, as when the disk is full.
    """
    with path.open("r+b") as file:
        beginning = _beginning()
        # A power cut may have left less than that.
        if not beginning.startswith(file.read(len(beginning))):
            return None
        file.seek(0)
        file.write(beginning)
        index = FileIndex()
        end = len(beginning)
        for record in _whole_records(file):
            if record.opcode == Opcode.DATA_END:
                break
            if record.opcode == Opcode.CHUNK:
                chunk = _read_chunk(record.body, index)
                if chunk is None:
                    break
                end = record.start + RECORD.size + len(record.body)
                indexes, line = _index_of(chunk, record.start, end - record.start)
                index.chunks.append(line)
                file.seek(end)
                file.write(indexes)
                end += len(indexes)
        file.seek(end)
        file.truncate()
        file.write(_end(index, end))
        file.flush()
        os.fsync(file.fileno())
    return index


class _Record(NamedTuple):
    opcode: int
    start: int
    body: bytes


def _whole_records(file: BinaryIO) -> Iterator[_Record]:
    """Yield the records that are there as a whole, from the file's position on."""
    while True:
        start = file.tell()
        head = file.read(RECORD.size)
        if len(head) < RECORD.size:
            return
        opcode, length = RECORD.unpack(head)
        if length > os.fstat(file.fileno()).st_size - start:
            return
        yield _Record(opcode, start, file.read(length))


def _read_chunk(body: bytes, index: FileIndex) -> _Chunk | None:
    """Read a chunk's records, and take its schemas and channels over; None if it is damaged."""
    if len(body) < CHUNK.size:
        return None
    *_, crc, _, size = CHUNK.unpack_from(body)
    data = body[CHUNK.size :]
    if len(data) != size or zlib.crc32(data) != crc:
        return None
    chunk = _Chunk()
    try:
        for record in _records_in(data):
            chunk.size = record.start
            _note_record(chunk, index, record)
    except (struct.error, McapError, UnicodeDecodeError):
        return None
    chunk.size = size
    return chunk


def _records_in(data: bytes) -> Iterator[_Record]:
    position = 0
    while position < len(data):
        opcode, length = RECORD.unpack_from(data, position)
        begin = position + RECORD.size
        yield _Record(opcode, position, data[begin : begin + length])
        position = begin + length


def _note_record(chunk: _Chunk, index: FileIndex, record: _Record) -> None:
    stream = ReadDataStream(BytesIO(record.body))
    if record.opcode == Opcode.SCHEMA:
        index.add(Schema.read(stream))
    elif record.opcode == Opcode.CHANNEL:
        index.add(Channel.read(stream))
    elif record.opcode == Opcode.MESSAGE:
        channel, _, log_ns, _ = MESSAGE.unpack_from(record.body)
        chunk.note_message(channel, log_ns)
        index.counts[channel] += 1

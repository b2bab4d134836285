"""Writes H.264 as an MPEG transport stream (ISO/IEC 13818-1), which ffplay, VLC and mpv read.

`streams` has one a viewer. A frame is one PES packet with a timestamp, its first packet has the clock. Pure.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from itertools import chain, cycle, islice

PACKET_BYTES = 188
# Size of a packet without its header.
ROOM_BYTES = 184
ROOM = struct.Struct("184s")
SYNC = 0x47
PAT_PID, VIDEO_PID, PMT_PID = 0, 0x100, 0x1000
STREAM_ID_VIDEO = 0xE0
CLOCK_HZ = 90_000
# Number of a clock's values.
CLOCK_MODULO = 2**33
# Time of a stream's first frame, and how far its clock is behind each frame's timestamp: time for a player to decode.
FIRST_PTS = CLOCK_HZ
CLOCK_BEHIND = CLOCK_HZ // 10
# Maximum interval between the tables with which a player finds the video, in ticks of the clock.
TABLES_EVERY = CLOCK_HZ // 2
# Bits of a packet's header and its adaptation field.
START, HAS_FIELD, HAS_PAYLOAD = 0x4000, 0x20, 0x10
RANDOM_ACCESS, HAS_CLOCK = 0x40, 0x10
# The access unit delimiter, with which each frame in a transport stream begins (ISO/IEC 14496-10, 7.3.2.4).
DELIMITER = b"\0\0\0\1\x09\xf0"
DELIMITERS = (DELIMITER[:5], DELIMITER[1:5])
# The tables, each of one section with its CRC (2.4.4): program 1 is described at PMT_PID; its clock and its only
# stream, H.264 (type 1b), are at VIDEO_PID.
PAT = bytes.fromhex("00 b00d 0001 c10000 0001 f000 2ab104b2")
PMT = bytes.fromhex("02 b012 0001 c10000 e100 f000 1b e100 f000 15bd4d56")
# Of packets inside a frame that have neither a start nor a field, by continuity counter.
FULL_HEADERS = tuple(
    bytes((SYNC, VIDEO_PID >> 8, VIDEO_PID & 0xFF, HAS_PAYLOAD | counter)) for counter in range(16)
)


class TransportStream:
    """One stream of H.264 frames, as Annex B access units, which may begin with any key frame."""

    def __init__(self) -> None:
        self._counters: Counter[int] = Counter()
        self._first_s: float | None = None
        self._pts = 0
        self._tables_pts = -TABLES_EVERY

    def write(self, frame: bytes | memoryview, timestamp_s: float, *, is_key: bool) -> bytes:
        """Write the next frame, with the tables when they are due; timestamps are by any one clock."""
        pts = self._pts = self._next_pts(timestamp_s)
        packets = []
        if is_key or pts - self._tables_pts >= TABLES_EVERY:
            self._tables_pts = pts
            # A section begins after a pointer.
            packets += [self._packet(PAT_PID, b"\0" + PAT), self._packet(PMT_PID, b"\0" + PMT)]
        flags = HAS_CLOCK | (RANDOM_ACCESS if is_key else 0)
        field = bytes((flags,)) + _clock(pts - CLOCK_BEHIND)
        return b"".join([*packets, *self._frame_packets(_pes(frame, pts), field)])

    def _next_pts(self, timestamp_s: float) -> int:
        """Return the timestamp in ticks, which only grows: players stumble over what comes before."""
        if self._first_s is None:
            self._first_s = timestamp_s
        pts = FIRST_PTS + round((timestamp_s - self._first_s) * CLOCK_HZ)
        return max(pts, self._pts + 1)

    def _frame_packets(self, pes: bytes, field: bytes) -> Iterator[bytes]:
        begin = ROOM_BYTES - 1 - len(field)
        yield self._packet(VIDEO_PID, pes[:begin], field)
        count = max(0, len(pes) - begin) // ROOM_BYTES
        end = begin + count * ROOM_BYTES
        if count:
            # A large frame has thousands, which nothing here touches one by one.
            headers = islice(cycle(FULL_HEADERS), self._counters[VIDEO_PID] % 16, None)
            payloads = chain.from_iterable(ROOM.iter_unpack(memoryview(pes)[begin:end]))
            self._counters[VIDEO_PID] += count
            yield b"".join(chain.from_iterable(zip(headers, payloads, strict=False)))
        if end < len(pes):
            yield self._packet(VIDEO_PID, pes[end:], b"", start=0)

    def _packet(
        self, pid: int, payload: bytes, field: bytes | None = None, *, start: int = START
    ) -> bytes:
        """Write one packet; a table is filled up behind it, a frame in the adaptation field before it (2.4.3.4)."""
        stuffing = ROOM_BYTES - len(payload)
        adaptation = b""
        if field is not None and stuffing:
            # Its length, flags, the clock, and stuffing; of one byte it is the length alone.
            fields = field or (b"\0" if stuffing > 1 else b"")
            adaptation = bytes((stuffing - 1,)) + fields.ljust(stuffing - 1, b"\xff")
        control = HAS_PAYLOAD | (HAS_FIELD if adaptation else 0) | self._counters[pid] % 16
        self._counters[pid] += 1
        header = bytes((SYNC,)) + (start | pid).to_bytes(2, "big") + bytes((control,))
        return (header + adaptation + payload).ljust(PACKET_BYTES, b"\xff")


def _pes(frame: bytes | memoryview, pts: int) -> bytes:
    """Write a frame as a PES packet (2.4.3.6) with its timestamp."""
    delimiter = b"" if bytes(frame[:5]).startswith(DELIMITERS) else DELIMITER
    # Begins with a frame; has a timestamp for presentation; 5 more bytes of header.
    header = b"\x84\x80\x05" + _timestamp(pts)
    size = len(header) + len(delimiter) + len(frame)
    # With its length a player need not wait for the next frame; more than 16 bits are 0.
    length = size if size < 2**16 else 0
    start = b"\0\0\1" + bytes((STREAM_ID_VIDEO,)) + length.to_bytes(2, "big")
    return b"".join((start, header, delimiter, frame))


def _timestamp(ticks: int) -> bytes:
    """Write 33 bits in three parts, each with a marker behind it."""
    ticks %= CLOCK_MODULO
    parts = 0x2 << 36 | (ticks >> 30) << 33 | 1 << 32
    parts |= (ticks >> 15 & 0x7FFF) << 17 | 1 << 16 | (ticks & 0x7FFF) << 1 | 1
    return parts.to_bytes(5, "big")


def _clock(ticks: int) -> bytes:
    """Write a program clock reference: 33 bits, 6 reserved ones, and no fraction."""
    return (ticks % CLOCK_MODULO << 15 | 0x3F << 9).to_bytes(6, "big")

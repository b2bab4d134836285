"""Reads the sixteen bytes before each frame (docs/reference/media.md), for tests of whoever sends them."""

from __future__ import annotations

from robotether_agent.video.receiver import Header
from robotether_common.codecs import CODECS
from robotether_common.frames import HEADER, STAMPED

SIZE = HEADER.size


def unpacked(message: bytes) -> Header:
    codec, flags, quality, sequence, timestamp_ms = HEADER.unpack_from(message)
    return Header(sequence, timestamp_ms, quality, bool(flags & STAMPED), CODECS[codec])

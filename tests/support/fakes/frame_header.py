"""Reads the sixteen bytes before each frame (docs/reference/media.md), for tests of whoever sends them."""

from __future__ import annotations

from robotether_agent.video.frame_messages import Header
from robotether_common.codecs import CODECS
from robotether_common.frames import HEADER, KEY, STAMPED

SIZE = HEADER.size


def unpacked(message: bytes) -> Header:
    codec, flags, quality, sequence, timestamp_ms = HEADER.unpack_from(message)
    is_stamped, is_key = bool(flags & STAMPED), bool(flags & KEY)
    return Header(sequence, timestamp_ms, quality, is_stamped, CODECS[codec], is_key)

"""Reads the sixteen bytes before each frame (docs/media.md), for tests of whoever sends them."""

from __future__ import annotations

import struct

from robotether_agent.media.header import STAMPED, Header

HEADER = struct.Struct("!BBHId")
SIZE = HEADER.size


def unpacked(message: bytes) -> Header:
    """Return the header at the start of `message`."""
    codec, flags, quality, number, moment_ms = HEADER.unpack_from(message)
    return Header(number, moment_ms, quality, bool(flags & STAMPED), codec)

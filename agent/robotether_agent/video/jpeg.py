"""What a JPEG says of itself, without decoding it."""

from __future__ import annotations

import re
import struct

JPEG_START = b"\xff\xd8"
# The markers that begin a frame's own header: start of frame, without the tables that share their range (C4, C8, CC).
FRAME_MARKERS = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
# Begins a marker. Any number of fill bytes may stand before it, which must not cost a turn of the loop each.
_BEGUN = re.compile(rb"\xff+")
_SEGMENT = struct.Struct("!H")
_FRAME = struct.Struct("!HBHH")


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return width and height in pixels as the frame's own header says, or nothing if it has none."""
    at = len(JPEG_START)
    while (begun := _BEGUN.match(jpeg, at)) and (at := begun.end() - 1) + 4 <= len(jpeg):
        if jpeg[at + 1] in FRAME_MARKERS:
            if at + 2 + _FRAME.size > len(jpeg):
                return None
            _, _, height, width = _FRAME.unpack_from(jpeg, at + 2)
            return (width, height) if width and height else None
        at += 2 + _SEGMENT.unpack_from(jpeg, at + 2)[0]
    return None

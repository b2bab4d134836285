"""What a source delivers and what is requested of it; shared by all of the media service, data only."""

from __future__ import annotations

import struct
from dataclasses import dataclass

JPEG_START = b"\xff\xd8"
# The markers that begin a frame's own header: start of frame, without the tables that share their range (C4, C8, CC).
FRAME_MARKERS = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
MARKER = 0xFF
_SEGMENT = struct.Struct("!H")
_FRAME = struct.Struct("!HBHH")


@dataclass(frozen=True)
class CameraFrame:
    """One JPEG; both times are on the robot's clock (CLOCK_BOOTTIME), the first is what the frame shows."""

    jpeg: bytes
    timestamp_s: float
    arrived_s: float
    is_stamped: bool = False


@dataclass(frozen=True)
class SourceRequest:
    """What is asked of a source; equal ones share one. A quality of 0 and no size leave it to the camera."""

    topic: str
    quality: int
    width: int | None
    height: int | None
    # Frames a second, for sources that can be asked to give no more.
    fps: float


class SourceDownError(Exception):
    """A source gives no frames; the message tells people why."""

    def __init__(self, message: str, *, answers: bool = True) -> None:
        super().__init__(message)
        # False: nothing listens where the source should be, so that another kind may be tried.
        self.answers = answers


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return width and height in pixels as the frame's own header says, or nothing if it has none."""
    at = len(JPEG_START)
    while at + 4 <= len(jpeg) and jpeg[at] == MARKER:
        if jpeg[at + 1] in FRAME_MARKERS:
            if at + 2 + _FRAME.size > len(jpeg):
                return None
            _, _, height, width = _FRAME.unpack_from(jpeg, at + 2)
            return (width, height) if width and height else None
        at += 2 + _SEGMENT.unpack_from(jpeg, at + 2)[0]
    return None

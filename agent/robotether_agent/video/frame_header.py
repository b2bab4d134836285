"""The sixteen bytes before each frame of the frames protocol (docs/media.md); nothing but packing and reading."""

from __future__ import annotations

import struct
from dataclasses import dataclass

JPEG = 1
# The moment is the camera's own stamp.
STAMPED = 1
NUMBERS = 2**32
_HEADER = struct.Struct("!BBHId")
SIZE = _HEADER.size


@dataclass(frozen=True)
class Header:
    """What is told of a frame; `timestamp_ms` is on the sender's clock, `quality` 0 is unknown."""

    sequence: int
    timestamp_ms: float
    quality: int = 0
    is_stamped: bool = False
    codec: int = JPEG

    def packed(self) -> bytes:
        """Return the header as it stands on the wire."""
        flags = STAMPED if self.is_stamped else 0
        return _HEADER.pack(
            self.codec, flags, self.quality, self.sequence % NUMBERS, self.timestamp_ms
        )

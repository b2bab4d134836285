"""Frames of H.264 as a robot encodes them."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import av
import numpy as np

FPS = 15


@cache
def encoded_frames(count: int) -> tuple[tuple[bytes, bool], ...]:
    """Encode some frames of a gradient that moves; each with whether it is a key frame, as the first alone is."""
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 64, 48, "yuv420p"
    encoder.time_base = Fraction(1, FPS)
    encoder.options = {"preset": "ultrafast", "tune": "zerolatency"}
    encoded: list[tuple[bytes, bool]] = []
    for number in range(count):
        row = (np.arange(64) * 4 + number * 16).astype(np.uint8)
        frame = av.VideoFrame.from_ndarray(np.tile(row[:, None], (48, 1, 3)), "rgb24")
        frame.pts = number
        encoded += [(bytes(packet), packet.is_keyframe) for packet in encoder.encode(frame)]
    return tuple(encoded)

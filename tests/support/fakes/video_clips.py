"""Clips for tests of codecs: a texture that moves, with a camera's noise, as RGB and as JPEG."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import av
import numpy as np
from PIL import Image

Picture = np.ndarray[Any, Any]


def clip(frames: int, *, step: int, noise: float = 2.0) -> Iterator[Picture]:
    """Yield RGB frames that move by `step` pixels each, with noise of that deviation."""
    rng = np.random.default_rng(1)
    width, height = 320, 240
    wide = (width + step * frames, height)
    texture = np.zeros((height, wide[0], 3), np.float32)
    for grain, weight in ((40, 0.6), (12, 0.3), (4, 0.1)):
        coarse = rng.integers(0, 255, (height // grain + 1, wide[0] // grain + 1, 3), np.uint8)
        texture += weight * np.asarray(
            Image.fromarray(coarse).resize(wide, Image.Resampling.BICUBIC)
        )
    for number in range(frames):
        seen = texture[:, number * step : number * step + width]
        yield (seen + rng.normal(0, noise, seen.shape)).clip(0, 255).astype(np.uint8)


def jpeg_of(picture: Picture, quality: int = 90) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=quality)
    return file.getvalue()


def pixels_of(jpeg: bytes) -> Picture:
    return np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB"))


def psnr(one: Picture, other: Picture) -> float:
    """Return how near two frames are in dB, by their luma; 30 is poor, 40 good."""
    weights = np.array([0.299, 0.587, 0.114])
    error = np.mean(((one.astype(float) - other.astype(float)) @ weights) ** 2)
    return float(10 * np.log10(255**2 / error))


class Decoder:
    """What a viewer has: a decoder that gets one access unit after the other."""

    def __init__(self, codec: str = "h264") -> None:
        self._context: Any = av.CodecContext.create(codec, "r")
        self._context.thread_count = 1
        self._context.flags |= 0x80000  # AV_CODEC_FLAG_LOW_DELAY: no frame waits for the next

    def decode(self, data: bytes) -> Picture:
        """Return the frame of one access unit, which a decoder gives at once; an error for one that it cannot."""
        (frame,) = self._context.decode(av.Packet(data))
        assert not frame.is_corrupt
        return frame.to_ndarray(format="rgb24")

"""What the codecs part makes of what it has measured."""

from __future__ import annotations

import math

import pytest
from codec_bits import RatePoint, bits_at

OVERHEAD = 1.1


def encode(bits_per_s: float) -> RatePoint:
    """Have 30 dB at 1 Mbit/s, and 6 dB for each doubling; no encoder keeps its rate."""
    psnr_db = 30 + 6 * math.log2(bits_per_s / 1e6)
    return RatePoint(bits_per_s * OVERHEAD, 255**2 / 10 ** (psnr_db / 10), 0.005)


@pytest.mark.parametrize("psnr_db", [25.0, 31.7, 36.0])
def test_bits_are_those_that_came_and_not_those_that_were_asked_for(psnr_db: float) -> None:
    point = bits_at(psnr_db, 4e6, encode)
    assert point is not None
    assert point.psnr_db == pytest.approx(psnr_db)
    assert point.bits_per_s == pytest.approx(OVERHEAD * 1e6 * 2 ** ((psnr_db - 30) / 6))


def test_codec_that_needs_more_bits_than_jpeg_has_none() -> None:
    assert bits_at(43.0, 4e6, encode) is None

"""Raw images of ROS as frames: their colours, their distances as grey, and messages that lie."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from robotether_agent.video.newest_jpegs import CameraFailedError, JpegMaker
from robotether_agent.video.raw_images import FrameMaker, RawImage
from video_clips import Picture, pixels_of

ORANGE = (200, 100, 50)


def message(pixels: Picture, encoding: str, *, padding: int = 0, big: bool = False) -> Any:
    ordered = pixels.byteswap() if big else pixels
    rows = [row.tobytes() + b"\7" * padding for row in ordered]
    return {
        "width": pixels.shape[1],
        "height": pixels.shape[0],
        "step": len(rows[0]),
        "encoding": encoding,
        "is_bigendian": int(big),
        "data": base64.b64encode(b"".join(rows)).decode(),
    }


def shown(image: Mapping[str, Any]) -> Picture:
    return pixels_of(JpegMaker().jpeg(FrameMaker().frame(RawImage.of(image))))


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "pixel", "colour"),
    [
        ("rgb8", ORANGE, ORANGE),
        ("bgr8", ORANGE[::-1], ORANGE),
        ("rgba8", (*ORANGE, 9), ORANGE),
        ("bgra8", (*ORANGE[::-1], 9), ORANGE),
        ("mono8", 77, (77, 77, 77)),
    ],
)
def test_colours_are_shown_as_they_are(encoding, pixel, colour, padding):
    pixels = np.full((30, 50, np.size(pixel)), pixel, np.uint8)
    picture = shown(message(pixels, encoding, padding=padding))
    assert picture.shape == (30, 50, 3)
    assert np.abs(picture.astype(int) - colour).max() <= 4


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("encoding", "kind", "greys"),
    [
        ("mono16", np.uint16, {0: 0, 77 * 257: 77, 65535: 255}),
        # From white at 0 m to dark grey at 10 m and beyond; what is unknown is black.
        ("16UC1", np.uint16, {0: 0, 1: 255, 5000: 143, 10_000: 32, 65535: 32}),
        (
            "32FC1",
            np.float32,
            {0.0: 0, NAN: 0, -1.0: 0, 0.001: 255, 5.0: 143, 10.0: 32, 99.0: 32, INFINITE: 32},
        ),
    ],
)
def test_greys_of_more_bits(encoding, kind, greys, big):
    for value, grey in greys.items():
        picture = shown(message(np.full((16, 16), value, kind), encoding, padding=4, big=big))
        assert np.abs(picture.astype(int) - grey).max() <= 2, value


IMAGE = message(np.zeros((16, 16, 3), np.uint8), "rgb8")


@pytest.mark.parametrize(
    ("lie", "why"),
    [
        ({"encoding": "bayer_rggb8"}, "the encoding bayer_rggb8, which is not shown"),
        ({"height": 17}, "less data than their size"),
        ({"step": 1000}, "less data than their size"),
        ({"width": 2**31}, "make no sense"),
        ({"height": -1}, "make no sense"),
        ({"step": 47}, "make no sense"),
        ({"step": "48"}, "make no sense"),
        ({"data": [0] * 768}, "make no sense"),
        ({"data": "é"}, "make no sense"),
        ({"data": None}, "make no sense"),
    ],
)
def test_a_message_that_lies_is_refused(lie, why):
    with pytest.raises(CameraFailedError, match=why):
        RawImage.of(IMAGE | lie)

"""Bits, sizes, presets and key frames of encoded video."""

from __future__ import annotations

import pytest
from robotether_agent.video.encoding import (
    PresetSteps,
    encoded_size,
)

INTERVAL_S = 1 / 15


@pytest.mark.parametrize(
    ("own", "requested", "scale", "size"),
    [
        ((640, 480), None, 1.0, (640, 480)),
        ((641, 361), None, 1.0, (640, 360)),
        ((1280, 720), (640, 480), 1.0, (640, 360)),
        ((640, 480), (1280, 960), 0.5, (320, 240)),
        ((1280, 720), (640, 360), 0.35, (224, 126)),
        ((30, 2000), None, 0.35, (16, 700)),
    ],
)
def test_a_size_keeps_the_cameras_shape_and_never_grows(own, requested, scale, size):
    assert encoded_size(own, requested, scale) == size


class Clock:
    """A camera of 15 frames a second, whose encoder takes a part of each interval."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.steps = PresetSteps(0.0)

    def run(self, seconds: float, share: float) -> bool:
        keeps = True
        for _ in range(round(15 * seconds)):
            self.now_s += INTERVAL_S
            keeps = self.steps.on_encoded(self.now_s, share * INTERVAL_S, INTERVAL_S) and keeps
        return keeps


BUSY, ROOM = (1.5, 0.5), 0.05


@pytest.mark.parametrize(
    ("runs", "preset"),
    [
        ([(10, 0.25)], "veryfast"),
        ([(10, 0.25), (1, 0.5)], "superfast"),
        ([(10, 0.25), (1, 0.5), (1, 0.5)], "ultrafast"),
        # One slow frame changes nothing.
        ([(2, 0.1), (1 / 15, 20), (2, 0.1)], "veryfast"),
        # A change costs a key frame: it waits for half a minute of room, or a minute if the last one was wrong.
        ([BUSY, (25, ROOM)], "superfast"),
        ([BUSY, (25, ROOM), (10, ROOM)], "veryfast"),
        ([BUSY, (25, ROOM), (10, ROOM), (1, 0.5), (50, ROOM)], "superfast"),
        ([BUSY, (25, ROOM), (10, ROOM), (1, 0.5), (50, ROOM), (15, ROOM)], "veryfast"),
    ],
)
def test_the_preset_follows_the_processor(runs, preset):
    clock = Clock()
    for seconds, share in runs:
        assert clock.run(seconds, share)
    assert clock.steps.preset == preset


def test_the_fastest_preset_is_given_up_after_seconds_of_overload():
    clock = Clock()
    clock.run(3, 0.5)
    assert clock.steps.preset == "ultrafast"
    assert clock.run(10, 0.5)
    assert clock.run(2, 0.9)
    assert clock.run(1, 0.3)
    assert not clock.run(6, 0.9)

"""Frames a second."""

from __future__ import annotations

import itertools
from random import Random

import pytest
from robotether_agent.video.frame_rate_limiter import FrameRateCounter, FrameRateLimiter


def passed(limiter: FrameRateLimiter, moments: list[float]) -> list[int]:
    return [number for number, at in enumerate(moments) if limiter.allows(at)]


def test_a_camera_of_the_wanted_rate_loses_nothing_to_jitter():
    random = Random(1)
    moments = sorted(n / 15 + random.uniform(-0.02, 0.02) for n in range(300))
    assert len(passed(FrameRateLimiter(15), moments)) >= 298


@pytest.mark.parametrize(("camera", "wanted", "each"), [(30, 15, 2), (60, 15, 4), (30, 1, 30)])
def test_a_quicker_camera_is_thinned_evenly(camera, wanted, each):
    """After the first moments, each second one, or fourth, or thirtieth."""
    left = passed(FrameRateLimiter(wanted), [n / camera for n in range(10 * camera)])[4:]
    assert {after - before for before, after in itertools.pairwise(left)} <= {
        each,
        each + 1,
        each - 1,
    }
    assert len(left) == pytest.approx(10 * wanted, rel=0.1, abs=4)


def test_a_pause_is_not_made_up_for():
    """After a second of silence at most two come at once."""
    limiter = FrameRateLimiter(15)
    assert passed(limiter, [0.0, *(10 + n / 1000 for n in range(20))]) == [0, 1, 2]


def test_the_meter_forgets():
    """Only the last two seconds count."""
    counter = FrameRateCounter()
    for n in range(30):
        counter.note(n / 10)
    assert counter.rate(2.9) == pytest.approx(10, abs=0.5)
    assert counter.rate(10) == 0

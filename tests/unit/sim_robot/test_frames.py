"""Frames are drawn for viewers only, shared, and never faster than the camera."""

import asyncio
import itertools
from collections.abc import AsyncIterator

import pytest
from sim_robot.camera import Scene
from sim_robot.frames import FORMATS_KEPT, FrameFeed, FrameFormat
from sim_robot.kinematics import Pose, Velocity

SMALL = FrameFormat(32, 24, 50)


@pytest.fixture
async def feed() -> AsyncIterator[FrameFeed]:
    """A feed of 15 frames a second whose scenes are numbered by their stamp."""
    numbers = itertools.count()

    def look() -> Scene:
        return Scene("t", 20.0, Pose(1, 1, 0), Velocity(), (), 0.0, next(numbers))

    made = FrameFeed(look, 15.0)
    yield made
    await made.close()


async def test_nobody_looks_nothing_is_drawn(feed: FrameFeed) -> None:
    """A feed draws only what was asked for."""
    assert feed.drawn == 0
    await feed.next_frame(SMALL)
    assert feed.drawn == 1


async def test_viewers_share_one_drawing(feed: FrameFeed) -> None:
    """Twenty viewers of one format get the same frame, drawn once."""
    first = await feed.next_frame(SMALL)
    frames = await asyncio.gather(*(feed.next_frame(SMALL, first.number) for _ in range(20)))
    assert len(set(frames)) == 1
    assert feed.drawn == 2


async def test_at_most_15_frames_a_second(feed: FrameFeed) -> None:
    """Each frame has a number of its own, and none is given before the period of that number has begun."""
    clock, number = asyncio.get_running_loop().time, -1
    for _ in range(10):
        frame = await feed.next_frame(SMALL, number)
        assert frame.number > number
        assert clock() > frame.number / 15.0 - 0.001
        number = frame.number


async def test_slow_viewer_gets_the_newest(feed: FrameFeed) -> None:
    """Who comes back late skips what it missed."""
    first = await feed.next_frame(SMALL)
    fast = first
    while fast.number < first.number + 5:
        fast = await feed.next_frame(SMALL, fast.number)
    assert (await feed.next_frame(SMALL, first.number)).number >= fast.number


async def test_viewer_that_leaves_takes_nothing_along(feed: FrameFeed) -> None:
    """A cancelled wait leaves the frame to the others."""
    leaving = asyncio.create_task(feed.next_frame(SMALL))
    staying = asyncio.create_task(feed.next_frame(SMALL))
    await asyncio.sleep(0)
    leaving.cancel()
    assert (await asyncio.wait_for(staying, 5)).jpeg.startswith(b"\xff\xd8")


async def test_frozen_camera_gives_nothing_new(feed: FrameFeed) -> None:
    """Who waits while the camera is frozen gets a frame of after it, also when the wait began before."""
    first = await feed.next_frame(SMALL)
    waiting = asyncio.create_task(feed.next_frame(SMALL, first.number))
    await asyncio.sleep(0)
    feed.freeze(True)
    done, _ = await asyncio.wait([waiting], timeout=0.3)
    assert (done, feed.drawn, feed.is_frozen) == (set(), 1, True)
    feed.freeze(False)
    assert (await asyncio.wait_for(waiting, 5)).number > first.number + 3


async def test_formats_are_bounded(feed: FrameFeed) -> None:
    """Many sizes do not pile up."""
    for width in range(1, FORMATS_KEPT + 5):
        await feed.next_frame(FrameFormat(width, 8, 50))
    assert len(feed._newest) == FORMATS_KEPT

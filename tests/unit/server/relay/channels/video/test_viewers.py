"""Which frame of a feed one viewer gets next."""

from __future__ import annotations

import pytest
from robotether_common.frames import HEADER
from robotether_server.relay.channels.video.feeds import Feed, FeedTraffic
from robotether_server.relay.channels.video.frame_protocol import Frame
from robotether_server.relay.channels.video.viewers import Cursor


class Books(Feed):
    """A feed whose frames a test sets, and that notes what was taken."""

    def __init__(self, robot) -> None:
        super().__init__(robot, "/a", FeedTraffic())
        self.was_taken: list[int] = []

    def taken(self, sequence: int) -> None:
        self.was_taken.append(sequence)

    def show(self, position: int, received_s: float = 0.0) -> Frame:
        data = HEADER.pack(1, 0, 70, 0, 0) + b"jpeg"
        self.newest = Frame(
            data, sequence=position, position=position, timestamp_s=0.0, received_s=received_s
        )
        return self.newest

    @property
    def skipped(self) -> int:
        return self._traffic.skipped


@pytest.fixture
async def feed(sim1) -> Books:
    return Books(sim1)


async def test_the_newest_comes_next_and_once(feed):
    cursor = Cursor(feed, 0.0)
    assert cursor.next() is None
    first = feed.show(0)
    assert cursor.next() is first
    cursor.sent(first)
    assert cursor.next() is None
    feed.show(1)
    feed.show(2)
    last = feed.show(3)
    assert cursor.next() is last
    cursor.sent(last)
    assert cursor.next() is None
    assert feed.skipped == 2


async def test_a_fresh_frame_is_shown_to_who_comes(feed):
    """At once, and nothing was skipped."""
    frame = feed.show(7, received_s=10.0)
    cursor = Cursor(feed, 10.9)
    assert cursor.next() is frame
    cursor.sent(frame)
    assert cursor.next() is None
    assert (feed.was_taken, feed.skipped) == ([], 0)


async def test_an_old_frame_is_given_back(feed):
    """Who comes waits for the next, which the robot can only send when it has credit."""
    feed.show(7, received_s=10.0)
    cursor = Cursor(feed, 11.1)
    assert cursor.next() is None
    assert feed.was_taken == [7]
    frame = feed.show(8)
    assert cursor.next() is frame
    cursor.sent(frame)
    assert feed.skipped == 0


async def test_who_comes_before_a_frame_skips_what_it_did_not_take(feed):
    feed.show(7, received_s=10.0)
    cursor = Cursor(feed, 10.5)
    feed.show(8)
    last = feed.show(9)
    assert cursor.next() is last
    cursor.sent(last)
    assert feed.skipped == 2

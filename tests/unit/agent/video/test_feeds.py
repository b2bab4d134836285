"""Sources that are shared, open while somebody follows them, and opened again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from robotether_agent.video import feeds as feeds_module
from robotether_agent.video.feeds import Condition, Feeds
from robotether_agent.video.frame import Frame, Kind, SourceDownError, SourceRequest

WISH = SourceRequest("/camera", 70, None, None, 15.0)


class FakeSource:
    """A source that gives and ends as a test says; a clock too."""

    def __init__(self) -> None:
        self.takes: dict[SourceRequest, Callable[[Frame], None]] = {}
        self.opened = 0
        self.fault: Exception | None = None
        self.now_s = 100.0

    async def run(
        self,
        source_request: SourceRequest,
        take: Callable[[Frame], None],
        tell: Callable[[Kind], None],
    ) -> None:
        self.opened += 1
        tell("mjpeg")
        if self.fault is not None:
            raise self.fault
        self.takes[source_request] = take
        try:
            await asyncio.Event().wait()
        finally:
            del self.takes[source_request]

    def clock(self) -> float:
        return self.now_s

    def give(self, number: int = 1) -> None:
        for take in self.takes.values():
            take(Frame(fake_jpeg(number), self.now_s, self.now_s))


@pytest.fixture
def source() -> FakeSource:
    """What is behind the feeds."""
    return FakeSource()


@pytest.fixture
async def feeds(source: FakeSource) -> AsyncIterator[Feeds]:
    """All feeds of a robot."""
    made = Feeds(source.run, source.clock)
    yield made
    await made.close()


async def until_open(source: FakeSource, count: int = 1) -> None:
    await eventually(lambda: len(source.takes) == count, lambda: f"{len(source.takes)} are open")


async def test_equal_requests_share_a_source(feeds, source):
    """Two followers of one request, one source; another quality has its own."""
    got: dict[str, list[Frame]] = {"a": [], "b": []}
    followed = [feeds.follow(WISH, name, got[name].append) for name in got]
    await until_open(source)
    source.give()
    assert (source.opened, len(got["a"]), len(got["b"])) == (1, 1, 1)
    other = feeds.follow(SourceRequest("/camera", 60, None, None, 15.0), "a", got["a"].append)
    await until_open(source, 2)
    feeds.leave(other, "a")
    await until_open(source, 1)
    assert followed[0] is followed[1]


async def test_the_last_to_leave_closes_the_source(feeds, source):
    feed = feeds.follow(WISH, "a", print)
    feeds.follow(WISH, "b", print)
    await until_open(source)
    feeds.leave(feed, "a")
    source.give()
    assert source.takes
    feeds.leave(feed, "b")
    await until_open(source, 0)
    feeds.leave(feed, "b")


async def test_the_condition_follows_the_frames(feeds, source):
    """Waiting, live, waiting again after two seconds, down with the reason."""
    feed = feeds.follow(WISH, "a", lambda _: None)
    await until_open(source)
    assert feed.condition() == Condition("waiting", "", "mjpeg")
    source.give()
    assert feed.condition() == Condition("live", "", "mjpeg")
    source.now_s += 2.5
    assert feed.condition().state == "waiting"


async def test_a_source_that_ends_is_opened_again(feeds, source, monkeypatch):
    """Until it gives frames, and then it is not down any more."""
    monkeypatch.setattr(feeds_module, "MAX_PAUSE_S", 0.02)
    source.fault = SourceDownError("the camera has no power")
    feed = feeds.follow(WISH, "a", lambda _: None)
    await eventually(lambda: source.opened > 2, lambda: f"opened {source.opened} times")
    assert feed.condition() == Condition("down", "the camera has no power", "mjpeg")
    source.fault = None
    await until_open(source)
    source.give()
    assert feed.condition().state == "live"


async def test_a_defect_is_no_end(feeds, source, monkeypatch, caplog):
    """It is logged, told, and tried again."""
    monkeypatch.setattr(feeds_module, "MAX_PAUSE_S", 0.02)
    source.fault = KeyError("a defect")
    feed = feeds.follow(WISH, "a", lambda _: None)
    await eventually(lambda: source.opened > 1, lambda: f"opened {source.opened} times")
    assert feed.condition().state == "down"
    assert "KeyError" in caplog.text


async def test_closing_closes_all(feeds, source):
    feeds.follow(WISH, "a", lambda _: None)
    await until_open(source)
    await feeds.close()
    assert source.takes == {}

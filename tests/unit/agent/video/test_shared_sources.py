"""Sources that are shared, open while somebody follows them, and left for the next one."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from robotether_agent.video import shared_sources as shared_sources_module
from robotether_agent.video.shared_sources import (
    GIVE_UP_S,
    SharedSource,
    SharedSources,
    SourceSwitch,
)
from robotether_agent.video.sources import CameraFrame, SourceRequest
from robotether_common.frames import Source, VideoStatus

REQUEST = SourceRequest("/camera", 70, None, None, 15.0)


class FakeSource:
    def __init__(self) -> None:
        self.takes: dict[SourceRequest, Callable[[CameraFrame], None]] = {}
        self.opened = 0
        self.fault: Exception | None = None
        self.now_s = 100.0
        self.kind: Source = "mjpeg"

    async def run(
        self,
        source_request: SourceRequest,
        take: Callable[[CameraFrame], None],
        tell: Callable[[Source], None],
    ) -> None:
        self.opened += 1
        tell(self.kind)
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
            take(CameraFrame(fake_jpeg(number), self.now_s, self.now_s))


@pytest.fixture
def source() -> FakeSource:
    return FakeSource()


@pytest.fixture
async def shared_sources(source: FakeSource) -> AsyncIterator[SharedSources]:
    made = SharedSources(source.run, source.clock)
    yield made
    await made.close()


async def until_open(source: FakeSource, count: int = 1) -> None:
    await eventually(lambda: len(source.takes) == count, lambda: f"{len(source.takes)} are open")


async def test_the_condition_follows_the_frames(shared_sources, source):
    shared = shared_sources.follow(REQUEST, "a", lambda _: None)
    await until_open(source)
    assert shared.condition() == VideoStatus("waiting", "", "mjpeg")
    source.give()
    assert shared.condition() == VideoStatus("live", "", "mjpeg")
    source.now_s += 2.5
    assert shared.condition().state == "waiting"
    source.now_s += 1.5
    assert shared.condition() == VideoStatus("down", "camera /camera sends no frames", "mjpeg")
    source.give()
    assert shared.condition().state == "live"


async def test_a_defect_is_no_end(shared_sources, source, monkeypatch, caplog):
    monkeypatch.setattr(shared_sources_module, "MAX_PAUSE_S", 0.02)
    source.fault = KeyError("a defect")
    shared = shared_sources.follow(REQUEST, "a", lambda _: None)
    await eventually(lambda: source.opened > 1, lambda: f"opened {source.opened} times")
    assert shared.condition().state == "down"
    assert "KeyError" in caplog.text


HIGH, LOW = (SourceRequest("/camera", quality, None, None, 15.0) for quality in (80, 40))


class FakeSharedSource:
    def __init__(self, source_request: SourceRequest) -> None:
        self.source_request = source_request
        self.followers = {}
        self.state = "live"

    def condition(self) -> VideoStatus:
        return VideoStatus(self.state)


class FakeSharedSources:
    def __init__(self) -> None:
        self.open: dict[SourceRequest, FakeSharedSource] = {}
        self.now_s = 10.0

    def answered(self, source_request):
        return source_request

    def follow(self, source_request, who, take):
        shared = self.open.setdefault(source_request, FakeSharedSource(source_request))
        shared.followers[who] = take
        return shared

    def leave(self, shared: SharedSource, who: object) -> None:
        shared.followers.pop(who, None)
        if not shared.followers:
            self.open.pop(shared.source_request, None)

    def give(self, source_request: SourceRequest, timestamp_s: float) -> None:
        frame = CameraFrame(fake_jpeg(int(timestamp_s * 1000)), timestamp_s, self.now_s)
        for take in tuple(self.open[source_request].followers.values()):
            take(frame)


@pytest.fixture
def fake_sources() -> FakeSharedSources:
    return FakeSharedSources()


@pytest.fixture
def got() -> list[tuple[float, int]]:
    return []


@pytest.fixture
def switch(fake_sources, got) -> SourceSwitch:
    return SourceSwitch(
        fake_sources,
        lambda p, w: got.append((round(p.timestamp_s, 3), w.quality)),
        lambda: fake_sources.now_s,
    )


def test_the_new_source_is_open_before_the_old_one_ends(fake_sources, switch, got):
    switch.follow(HIGH)
    for n in range(10):
        fake_sources.give(HIGH, n * 0.066)
    switch.follow(LOW)
    assert set(fake_sources.open) == {HIGH, LOW}
    fake_sources.give(HIGH, 0.66)
    # The same frame at another quality, some ms later as the server's own stamp tells.
    fake_sources.give(LOW, 0.668)
    assert (switch.source_request, set(fake_sources.open)) == (LOW, {LOW})
    fake_sources.give(LOW, 0.726)
    assert [quality for _, quality in got] == [80] * 11 + [40]
    timestamps = [timestamp for timestamp, _ in got]
    assert timestamps == sorted(set(timestamps))


def test_an_older_frame_does_not_go_on(fake_sources, switch, got):
    switch.follow(HIGH)
    fake_sources.give(HIGH, 5.0)
    fake_sources.give(HIGH, 4.9)
    assert got == [(5.0, 80)]


def test_a_request_that_changes_meanwhile(fake_sources, switch):
    other = SourceRequest("/camera", 20, None, None, 15.0)
    switch.follow(HIGH)
    fake_sources.give(HIGH, 1.0)
    switch.follow(LOW)
    switch.follow(other)
    assert set(fake_sources.open) == {HIGH, other}
    switch.follow(HIGH)
    assert set(fake_sources.open) == {HIGH}


def test_a_new_source_that_gives_nothing_is_let_go(fake_sources, switch):
    switch.follow(HIGH)
    fake_sources.give(HIGH, 1.0)
    switch.follow(LOW)
    assert not switch.give_up_late()
    fake_sources.now_s += GIVE_UP_S
    assert switch.give_up_late()
    assert (switch.source_request, set(fake_sources.open)) == (HIGH, {HIGH})


def test_when_neither_gives_anything_the_newer_request_counts(fake_sources, switch):
    """So that what is wanted is asked for when the camera comes back."""
    switch.follow(HIGH)
    fake_sources.open[HIGH].state = "down"
    switch.follow(LOW)
    fake_sources.now_s += GIVE_UP_S
    assert not switch.give_up_late()
    assert (switch.source_request, set(fake_sources.open)) == (LOW, {LOW})


def test_leaving_closes_both(fake_sources, switch):
    switch.follow(HIGH)
    switch.follow(LOW)
    switch.leave()
    assert (fake_sources.open, switch.source_request, switch.condition()) == (
        {},
        None,
        VideoStatus("waiting", source="web_video_server"),
    )
    switch.follow(LOW)
    assert switch.source_request == LOW

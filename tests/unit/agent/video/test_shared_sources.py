"""Sources that are shared, open while somebody follows them, and opened again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from robotether_agent.video import shared_sources as shared_sources_module
from robotether_agent.video.shared_sources import SharedSources
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

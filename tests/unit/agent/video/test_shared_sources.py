"""Sources that are shared, open while somebody follows them, and left for the next one."""

import asyncio

import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from robotether_agent.video import shared_sources as shared_sources_module
from robotether_agent.video.shared_sources import GIVE_UP_S, SharedSources, SourceSwitch
from robotether_agent.video.sources import CameraFrame, SourceRequest
from robotether_common.frames import VideoStatus

REQUEST = SourceRequest("/camera", 70, None, None, 15.0)


class FakeSource:
    def __init__(self):
        self.takes = {}
        self.opened = 0
        self.fault = None
        self.now_s = 100.0
        self.kind = "mjpeg"

    async def run(self, source_request, take, tell):
        self.opened += 1
        tell(self.kind)
        if self.fault is not None:
            raise self.fault
        self.takes[source_request] = take
        try:
            await asyncio.Event().wait()
        finally:
            del self.takes[source_request]

    def clock(self):
        return self.now_s

    def give(self, source_request=REQUEST, timestamp_s=100.0):
        frame = CameraFrame(fake_jpeg(int(timestamp_s * 1000)), timestamp_s, self.now_s)
        self.takes[source_request](frame)


@pytest.fixture
def source():
    return FakeSource()


@pytest.fixture
async def shared_sources(source):
    made = SharedSources(source.run, source.clock)
    yield made
    await made.close()


async def until_open(source, *requests):
    await eventually(lambda: set(source.takes) == set(requests), lambda: f"open: {source.takes}")


async def test_the_condition_follows_the_frames(shared_sources, source):
    shared = shared_sources.follow(REQUEST, "a", lambda _: None)
    await until_open(source, REQUEST)
    assert shared.condition() == VideoStatus("waiting", "", "mjpeg")
    source.give()
    assert shared.condition() == VideoStatus("live", "", "mjpeg")
    source.now_s += 2.5
    assert shared.condition().state == "waiting"
    source.now_s += 1.5
    assert shared.condition() == VideoStatus(
        "down", "camera /camera has sent no frame for 4 s", "mjpeg"
    )
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


@pytest.fixture
def got():
    return []


@pytest.fixture
def switch(shared_sources, source, got):
    return SourceSwitch(
        shared_sources,
        lambda p, w: got.append((round(p.timestamp_s, 3), w.quality)),
        source.clock,
    )


async def test_the_new_source_is_open_before_the_old_one_ends(source, switch, got):
    switch.follow(HIGH)
    await until_open(source, HIGH)
    for n in range(10):
        source.give(HIGH, n * 0.066)
    switch.follow(LOW)
    await until_open(source, HIGH, LOW)
    source.give(HIGH, 0.66)
    # The same frame at another quality, some ms later as the server's own stamp tells.
    source.give(LOW, 0.668)
    assert switch.source_request == LOW
    await until_open(source, LOW)
    source.give(LOW, 0.726)
    assert [quality for _, quality in got] == [80] * 11 + [40]
    timestamps = [timestamp for timestamp, _ in got]
    assert timestamps == sorted(set(timestamps))


async def test_an_older_frame_does_not_go_on(source, switch, got):
    switch.follow(HIGH)
    await until_open(source, HIGH)
    source.give(HIGH, 5.0)
    source.give(HIGH, 4.9)
    assert got == [(5.0, 80)]


async def test_a_request_that_changes_meanwhile(source, switch):
    other = SourceRequest("/camera", 20, None, None, 15.0)
    for request in (HIGH, LOW):
        switch.follow(request)
    await until_open(source, HIGH, LOW)
    switch.follow(other)
    await until_open(source, HIGH, other)
    switch.follow(HIGH)
    await until_open(source, HIGH)


@pytest.mark.parametrize("is_live", [True, False])
async def test_a_new_source_that_gives_nothing_is_let_go(source, switch, is_live):
    """When neither gives anything, the newer request counts: it is asked for when the camera comes back."""
    switch.follow(HIGH)
    switch.follow(LOW)
    await until_open(source, HIGH, LOW)
    assert not switch.give_up_late()
    source.now_s += GIVE_UP_S
    if is_live:
        source.give(HIGH)
    assert switch.give_up_late() is is_live
    assert switch.source_request == (HIGH if is_live else LOW)
    await until_open(source, HIGH if is_live else LOW)


async def test_leaving_closes_both(source, switch):
    switch.follow(HIGH)
    switch.follow(LOW)
    await until_open(source, HIGH, LOW)
    switch.leave()
    await until_open(source)
    nothing = VideoStatus("waiting", source="web_video_server")
    assert (switch.source_request, switch.condition()) == (None, nothing)
    switch.follow(LOW)
    assert switch.source_request == LOW

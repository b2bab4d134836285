"""Going over from one source to the next: no gap, no frame twice, none out of order."""

from __future__ import annotations

import pytest
from fake_cameras import fake_jpeg
from robotether_agent.video.shared_sources import GIVE_UP_S, SharedSource, SourceSwitch
from robotether_agent.video.sources import CameraFrame, SourceRequest
from robotether_common.frames import VideoStatus

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
def shared_sources() -> FakeSharedSources:
    return FakeSharedSources()


@pytest.fixture
def got() -> list[tuple[float, int]]:
    return []


@pytest.fixture
def switch(shared_sources, got) -> SourceSwitch:
    return SourceSwitch(
        shared_sources,
        lambda p, w: got.append((round(p.timestamp_s, 3), w.quality)),
        lambda: shared_sources.now_s,
    )


def test_the_new_source_is_open_before_the_old_one_ends(shared_sources, switch, got):
    switch.follow(HIGH)
    for n in range(10):
        shared_sources.give(HIGH, n * 0.066)
    switch.follow(LOW)
    assert set(shared_sources.open) == {HIGH, LOW}
    shared_sources.give(HIGH, 0.66)
    # The same frame at another quality, some ms later as the server's own stamp tells.
    shared_sources.give(LOW, 0.668)
    assert (switch.source_request, set(shared_sources.open)) == (LOW, {LOW})
    shared_sources.give(LOW, 0.726)
    assert [quality for _, quality in got] == [80] * 11 + [40]
    timestamps = [timestamp for timestamp, _ in got]
    assert timestamps == sorted(set(timestamps))


def test_an_older_frame_does_not_go_on(shared_sources, switch, got):
    switch.follow(HIGH)
    shared_sources.give(HIGH, 5.0)
    shared_sources.give(HIGH, 4.9)
    assert got == [(5.0, 80)]


def test_a_request_that_changes_meanwhile(shared_sources, switch):
    other = SourceRequest("/camera", 20, None, None, 15.0)
    switch.follow(HIGH)
    shared_sources.give(HIGH, 1.0)
    switch.follow(LOW)
    switch.follow(other)
    assert set(shared_sources.open) == {HIGH, other}
    switch.follow(HIGH)
    assert set(shared_sources.open) == {HIGH}


def test_a_new_source_that_gives_nothing_is_let_go(shared_sources, switch):
    switch.follow(HIGH)
    shared_sources.give(HIGH, 1.0)
    switch.follow(LOW)
    assert not switch.give_up_late()
    shared_sources.now_s += GIVE_UP_S
    assert switch.give_up_late()
    assert (switch.source_request, set(shared_sources.open)) == (HIGH, {HIGH})


def test_when_neither_gives_anything_the_newer_request_counts(shared_sources, switch):
    """So that what is wanted is asked for when the camera comes back."""
    switch.follow(HIGH)
    shared_sources.open[HIGH].state = "down"
    switch.follow(LOW)
    shared_sources.now_s += GIVE_UP_S
    assert not switch.give_up_late()
    assert (switch.source_request, set(shared_sources.open)) == (LOW, {LOW})


def test_leaving_closes_both(shared_sources, switch):
    switch.follow(HIGH)
    switch.follow(LOW)
    switch.leave()
    assert (shared_sources.open, switch.source_request, switch.condition()) == (
        {},
        None,
        VideoStatus("waiting", source="web_video_server"),
    )
    switch.follow(LOW)
    assert switch.source_request == LOW

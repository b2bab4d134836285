"""A feed and the books that it keeps of credits, without a network; and all feeds of a relay."""

import asyncio
import struct
import time
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest
from robotether_common.codecs import NAMES, decoded_by
from robotether_common.frames import ENCODER_STARTS, StreamRequest, VideoStatus
from robotether_server.problems import ProtocolError
from robotether_server.relay.channels.video import feeds as feeds_module
from robotether_server.relay.channels.video.feeds import Feed, FeedKey, Feeds, FeedTraffic
from robotether_server.relay.channels.video.frame_protocol import SenderClock
from robotether_server.relay.channels.video.held_frames import MAX_HELD
from robotether_server.relay.channels.video.viewers import ViewerPlace
from robotether_server.relay.http import close_reasons
from robotether_server.relay.robots.drive_log import CameraCounts
from robotether_server.relay.robots.registry import SessionRegistry

JPEG = b"\xff\xd8\xff\xd9"


class Eye:
    is_recorder = may_drive = False
    round_trip_s = 0.0

    def __init__(self, stream_request=None, *, user_id=1, breaks=False):
        self.stream_request = stream_request
        self._user_id = user_id
        self.on_status = 0
        self.close_reasons = []
        self._breaks = breaks

    def user_ids(self):
        return (self._user_id,)

    def notify(self):
        self.on_status += 1
        if self._breaks:
            raise RuntimeError("a defect of this viewer")

    def end(self, close_reason):
        self.close_reasons.append(close_reason)


def clock():
    clock = SenderClock()
    now_s = time.monotonic()
    clock.on_answer(now_s, now_s * 1000, now_s * 1000)
    return clock


def come(feed, sequence, *, codec=1, is_key=False):
    now_s = time.monotonic()
    header = struct.pack("!BBHId", codec, 2 * is_key, 70, sequence, now_s * 1000)
    feed.on_frame(header + JPEG, now_s, clock())


@pytest.fixture
async def feed(sim1):
    """A feed that has its connection and has told its first credit."""
    feed = Feed(sim1, FeedKey("/a"), FeedTraffic(), CameraCounts())
    feed.on_connected()
    assert feed.credit() == (2, None)
    return feed


async def test_more_frames_than_credits_break_the_protocol(feed):
    come(feed, 1)
    come(feed, 2)
    with pytest.raises(ProtocolError, match="more frames"):
        come(feed, 3)


async def test_what_nobody_took_before_they_left_is_given_back(feed):
    """It neither keeps the robot from the next frame, nor counts as one that came late."""
    one, other = Eye(), Eye()
    feed.join(one)
    come(feed, 1)
    come(feed, 2)
    feed.join(other)
    assert feed.credit() is None
    feed.leave(one)
    feed.leave(other)
    feed.join(other)
    assert feed.credit() == (2, None)


@pytest.mark.parametrize(("round_trip_s", "latency_ms"), [(0.09, 300), (0.29, 500), (60, 5000)])
async def test_a_long_way_is_not_taken_for_a_full_line(feed, round_trip_s, latency_ms):
    """Who drives from the other side of the world would have the least quality all the time."""
    eye = Eye(StreamRequest())
    feed.join(eye)
    eye.round_trip_s = round_trip_s
    assert feed.stream_request().latency_ms == latency_ms


async def test_one_viewers_defect_is_its_own(feed, caplog):
    broken, sound = Eye(breaks=True), Eye()
    feed.join(broken)
    feed.join(sound)
    come(feed, 1)
    assert sound.on_status == 1
    assert broken.close_reasons == [close_reasons.relay_failed()]
    assert "a defect of this viewer" in caplog.text


async def _for_ever():
    return await asyncio.get_running_loop().create_future()


@contextmanager
def followed(feeds, robot, camera, viewer):
    feed = feeds.follow(robot, feeds.key_for(robot, camera, viewer), viewer)
    try:
        yield feed
    finally:
        feeds.leave(feed, viewer)


def feeds_that(work):
    return Feeds(SessionRegistry(), lambda _feed: work())


class Recording(Eye):
    is_recorder = True


def eye(*codecs, may_drive=False, user_id=1):
    made = Eye(StreamRequest(codecs=decoded_by(codecs)), user_id=user_id)
    made.may_drive = may_drive
    return made


@pytest.mark.parametrize(
    ("h264_may_drive", "jpeg_may_drive", "driver_id", "yields"),
    [
        (True, True, None, True),
        (False, False, None, True),
        (True, True, 1, True),
        (False, True, None, False),
        (True, True, 2, False),
    ],
)
async def test_who_does_not_decode_h264_takes_it_from_nobody(
    *, sim1, h264_may_drive, jpeg_may_drive, driver_id, yields
):
    """A second feed has little, unless the driver needs it; the recorder takes what the driver sees."""
    registry = SessionRegistry()
    feeds = Feeds(registry, lambda _feed: _for_ever())
    if driver_id is not None:
        holder = SimpleNamespace(user_id=driver_id, is_route=False)
        registry.ensure_robot(sim1.id).lease.driver = SimpleNamespace(holder=holder)
    recording = Recording(StreamRequest(codecs=NAMES))
    first, second = (
        eye("h264", "vp8", may_drive=h264_may_drive),
        eye("vp8", may_drive=jpeg_may_drive, user_id=2),
    )
    with followed(feeds, sim1, "/a", second) as jpeg:
        assert jpeg.stream_request().codecs == ("vp8", "jpeg")
        assert jpeg.stream_request().yields == (driver_id == 1)
        with followed(feeds, sim1, "/a", first) as h264:
            yielding = replace(first.stream_request, yields=driver_id == 2)
            assert h264.stream_request() == yielding
            request = jpeg.stream_request()
            assert (request.codecs, request.yields) == (("jpeg",), yields)
            assert request.fps == (feeds_module.YIELDING_FPS if yields else StreamRequest().fps)
            goes_first = h264 if yields else jpeg
            assert feeds.key_for(sim1, "/a", recording) == goes_first.key
        assert jpeg.stream_request() == replace(second.stream_request, yields=driver_id == 1)
    assert feeds.key_for(sim1, "/a", recording) == FeedKey("/a")
    await feeds.close()


@pytest.mark.parametrize(
    ("codec", "status", "shares"),
    [
        (1, VideoStatus("live", codec="jpeg", no_encoder="PyAV is missing"), True),
        (1, VideoStatus("live", codec="jpeg", no_encoder=ENCODER_STARTS), False),
        (1, VideoStatus("live", codec="jpeg", encoder="libx264", no_encoder="it is slow"), False),
        # Its status is of before the frame.
        (1, VideoStatus("live"), False),
        (2, VideoStatus("live", codec="h264"), False),
    ],
)
async def test_a_robot_without_an_encoder_sends_jpeg_once(sim1, codec, status, shares):
    """Its viewers share a feed, until H.264 comes after all."""
    feeds, viewer = feeds_that(_for_ever), eye()
    with followed(feeds, sim1, "/a", eye("h264")) as h264:
        h264.on_connected()
        h264.credit()
        come(h264, 1, codec=codec, is_key=True)
        h264.on_status(status)
        with followed(feeds, sim1, "/a", viewer) as feed:
            assert (feed is h264) is shares
            assert h264.stream_request().codecs == ("h264", "jpeg")
            come(h264, 2, codec=2, is_key=True)
            assert not feeds.key_for(sim1, "/a", viewer).decodes_h264
    await feeds.close()


def connect(feed):
    feed.on_connected()
    feed.credit()


@pytest.mark.parametrize("comes_first", ["JPEG", "H.264"])
async def test_no_jpeg_is_missing_when_an_encoder_starts(sim1, comes_first):
    """A viewer stays until its own feed has a JPEG, or the one that it leaves has no more of them."""
    feeds, viewer, other = feeds_that(_for_ever), eye(), eye("h264", user_id=2)
    with followed(feeds, sim1, "/a", other) as first:
        connect(first)
        come(first, 1)
        first.on_status(VideoStatus("live", codec="jpeg", no_encoder="it was too slow"))
        place = ViewerPlace(feeds, sim1, "/a", viewer)
        assert place.feed is first
        first.on_status(VideoStatus("live", codec="jpeg", no_encoder=ENCODER_STARTS))
        assert not place.move()
        assert place.cursor.next() is first.newest
        (second,) = (feed for feed in feeds._tasks if feed is not first)
        connect(second)
        if comes_first == "JPEG":
            come(second, 1)
        else:
            come(first, 2, codec=2, is_key=True)
        assert place.move()
        assert place.feed is second
        assert place.cursor.next() is second.newest
        assert (first.users, second.users) == ({other}, {viewer})
        place.leave()
    await feeds.close()


async def test_a_recording_has_no_gap_when_another_feed_goes_first(sim1):
    """It goes over at a key frame, which is requested; where that does not come, it stays."""
    feeds, recording = feeds_that(_for_ever), Recording(StreamRequest(codecs=NAMES))
    with followed(feeds, sim1, "/a", eye()) as jpeg:
        place = ViewerPlace(feeds, sim1, "/a", recording)
        assert place.feed is jpeg
        connect(jpeg)
        come(jpeg, 1)
        with followed(feeds, sim1, "/a", eye("h264", may_drive=True)) as h264:
            connect(h264)
            come(h264, 1, codec=2, is_key=True)
            for number in range(2, MAX_HELD + 3):
                h264.taken(number - 1)
                h264.credit()
                come(h264, number, codec=2)
            assert not place.move()
            assert place.feed is jpeg
            assert h264.needs_key_frame
            h264.credit()
            come(h264, MAX_HELD + 3, codec=2, is_key=True)
            assert place.move()
            assert place.cursor.next() is h264.newest
            assert recording not in jpeg.users
            place.leave()
    await feeds.close()


async def test_few_feeds_linger(sim1, monkeypatch):
    """Who opens and leaves one camera after the other must not use up the room that a robot has for others."""
    monkeypatch.setattr("robotether_server.relay.robots.shared_copies.LINGER_S", 60)
    feeds = feeds_that(_for_ever)
    with followed(feeds, sim1, "/watched", Eye()):
        for sequence in range(20):
            with followed(feeds, sim1, f"/{sequence}", Eye()):
                pass
        assert feeds.count() == 1 + feeds_module.MAX_LINGERING
    await feeds.close()

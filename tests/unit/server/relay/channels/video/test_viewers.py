"""Which frame of a feed one viewer gets next."""

import asyncio
import struct
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st
from robotether_common.codecs import H264, JPEG, NAMES, VP8, decoded_by
from robotether_common.frames import HEADER, KEY, MAX_CREDITS, StreamRequest
from robotether_server.relay.channels.video.feeds import Feed, FeedKey, FeedTraffic
from robotether_server.relay.channels.video.frame_protocol import Frame, SenderClock
from robotether_server.relay.channels.video.held_frames import MAX_HELD, MAX_HELD_BYTES, HeldFrames
from robotether_server.relay.channels.video.viewers import Cursor
from robotether_server.relay.robots.drive_log import CameraCounts


class Watcher:
    """A viewer that decodes what it gets, and fails when it cannot."""

    def __init__(self, feed, codecs, now_s):
        self.stream_request = StreamRequest(codecs=decoded_by(codecs))
        self.newest = -1
        self.round_trip_s, self.is_recorder = 0.0, False
        self._feed = feed
        self._credits = 0
        self._under_way = []
        # Chain and number within it that a decoder expects next.
        self._expected = None
        feed.join(self)
        self._cursor = Cursor(feed, self, now_s)

    def user_ids(self):
        return (1,)

    def end(self, close_reason):
        raise AssertionError(close_reason)

    def notify(self):
        while self._credits and (frame := self._cursor.next()) is not None:
            self._credits -= 1
            self._cursor.sent(frame)
            self._under_way.append(frame.sequence)
            self._decode(frame)

    def _decode(self, frame):
        assert frame.codec.name in self.stream_request.codecs
        assert frame.position > self.newest
        chain, number = struct.unpack("!II", frame.data)
        assert frame.is_key or self._expected == (chain, number)
        self.newest, self._expected = frame.position, (chain, number + 1)

    def credit(self, frames):
        self._credits = min(MAX_CREDITS, self._credits + frames)
        if self._under_way:
            self._feed.taken(self._under_way[-1])
            self._under_way.clear()
        self.notify()

    def restart(self):
        self._expected = None
        self._cursor.restart()
        self.notify()


class Scene:
    """A robot that encodes on credit, and its viewers. What a chain of frames is, it alone knows."""

    def __init__(self):
        self.feed = Feed(
            SimpleNamespace(name="sim1", id=7), FeedKey("/a"), FeedTraffic(), CameraCounts()
        )
        self.viewers = []
        self.codec = H264
        self.now_s = 1000.0
        self._sequence = self._chain = self._number = self.credits = 0
        self._clock = SenderClock()
        self.reconnect()

    def reconnect(self, *_):
        self.feed.on_connected()
        self.credits, self._sent_codec = 0, None
        self.encoder(self.codec)

    def encoder(self, codec):
        self.codec, self._number = codec, 0

    def frame(self, *, is_true=True, has_clock=True):
        """Send the next frame; one that is not true is no key frame although it should be."""
        self.now_s += 0.05
        credit = self.feed.credit()
        self.credits += 0 if credit is None else credit[0]
        assert self.credits <= MAX_CREDITS
        if not self.credits:
            return
        self.credits -= 1
        self._sequence += 1
        # Nobody can tell that an encoder begins anew where neither codec nor connection changes.
        is_hidden = not self._number and self.codec is self._sent_codec
        is_key = (is_true or is_hidden) and (self.feed.needs_key_frame or not self._number)
        self._sent_codec = self.codec
        if is_key or not self.codec.depends_on_earlier:
            self._chain, self._number, self.feed.needs_key_frame = self._chain + 1, 0, False
        now_ms = self.now_s * 1000
        flags = KEY if is_key else 0
        header = HEADER.pack(self.codec.number, flags, 70, self._sequence, now_ms)
        self._clock.on_answer(self.now_s, now_ms, now_ms)
        clock = self._clock if has_clock else SenderClock()
        data = header + struct.pack("!II", self._chain, self._number)
        self._number += 1
        self.feed.on_frame(data, self.now_s, clock)
        assert len(self.feed.held) <= MAX_HELD

    def act(self, kind, value, who):
        """Do one thing that may happen, to the viewer with this number if it concerns one."""
        viewer = self.viewers[who % len(self.viewers)] if self.viewers else None
        if kind == "frames":
            for _ in range(value):
                self.frame()
        elif kind == "false frame":
            self.frame(is_true=False)
        elif kind == "no clock":
            self.frame(has_clock=False)
        elif kind == "pause":
            self.now_s += value
        elif kind == "reconnect":
            self.reconnect()
        elif kind == "encoder":
            self.encoder(value)
        elif kind == "join":
            self.viewers.append(Watcher(self.feed, value, self.now_s))
        elif viewer is not None:
            self._act_on(viewer, kind, value)

    def _act_on(self, viewer, kind, value):
        if kind == "credit":
            viewer.credit(value)
        elif kind == "key_frame":
            viewer.restart()
        elif kind == "codecs":
            viewer.stream_request = StreamRequest(codecs=decoded_by(value))
        elif kind == "leave":
            self.feed.leave(viewer)
            self.viewers.remove(viewer)


CODECS = st.lists(st.sampled_from(NAMES))
ACTS = st.one_of(
    st.tuples(st.just("frames"), st.integers(1, 12)),
    st.tuples(st.just("credit"), st.integers(1, 2)),
    st.tuples(st.sampled_from(["join", "codecs"]), CODECS),
    st.tuples(st.just("encoder"), st.sampled_from([H264, VP8, JPEG])),
    st.tuples(st.just("pause"), st.floats(0, 2)),
    st.tuples(
        st.sampled_from(["key_frame", "leave", "reconnect", "false frame", "no clock"]), st.none()
    ),
)


@given(st.lists(st.tuples(ACTS, st.integers(0, 9)), max_size=60), CODECS)
def test_each_viewer_can_decode_what_it_gets_and_none_waits_for_ever(acts, codecs):
    """Whatever frames, viewers, connections and encoders do, as long as key frames come on request."""

    async def play():
        scene = Scene()
        for (kind, value), who in [*acts, (("join", codecs), 0)]:
            scene.act(kind, value, who)
        for _ in range(10):
            for viewer in scene.viewers:
                viewer.credit(2)
            scene.frame()
        last = scene.feed.newest
        assert last is not None
        for viewer in scene.viewers:
            decodes = scene.codec.name in viewer.stream_request.codecs
            assert viewer.newest == last.position or not decodes

    asyncio.run(play())


def test_what_is_held_is_bounded():
    def add(position, size, received_s, flags=0):
        data = HEADER.pack(H264.number, flags, 70, 0, 0) + b"x" * size
        frame = Frame(
            data, sequence=position, position=position, timestamp_s=0.0, received_s=received_s
        )
        assert held.add(frame)

    held = HeldFrames()
    add(0, 1, 0.0, KEY)
    for position in range(1, 100):
        add(position, 1, 0.0)
    assert (len(held), held.start) == (MAX_HELD, None)
    add(100, MAX_HELD_BYTES // 2, 0.0)
    add(101, MAX_HELD_BYTES // 2, 0.0)
    assert len(held) == 2
    add(102, 1, 60.0)
    assert (len(held), held.at(100)) == (2, None)
    add(103, 1, 60.0, KEY)
    assert (len(held), held.start) == (1, held.newest)

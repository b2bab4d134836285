"""One feed a robot and camera, whatever the number of viewers: its newest frames, and credits for the robot.

A camera has a second feed while a viewer does not decode H.264, so that the others keep H.264.
`frames_handler` and `streams` join feeds; a `FeedLink` brings each its frames. Few frames are held, and each viewer
takes them when it can: nothing queues here, and a slow viewer skips frames and delays nobody.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from math import ceil
from operator import attrgetter
from typing import NamedTuple, Protocol

from robotether_common.codecs import CODECS, H264, JPEG, NAMES
from robotether_common.frames import (
    ENCODER_STARTS,
    HEADER,
    LATENCIES_MS,
    SEQUENCES,
    StreamRequest,
    VideoStatus,
)

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.channels.video.credits import Credits
from robotether_server.relay.channels.video.frame_protocol import (
    Frame,
    SenderClock,
    combined,
    depends_on_earlier,
    parse_frame,
)
from robotether_server.relay.channels.video.held_frames import HeldFrames
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.timing import TimeHistogram
from robotether_server.relay.robots.drive_log import CameraCounts
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.shared_copies import CopyUser, SharedCopies, SharedCopy

log = logging.getLogger(__name__)

# Maximum number of feeds of one robot without viewers; its agent has room for 8 cameras.
MAX_LINGERING = 2
# Maximum age of the frame that a new viewer gets at once.
FRESH_S = 1.0
# Maximum rate of JPEGs beside H.264 of the same camera, in frames a second.
YIELDING_FPS = 5.0
# Part of the requested latency that the way may take by itself, which no smaller frame shortens, and the steps in which
# more is added to it.
WAY_PART, WAY_STEP_MS = 1 / 3, 50


@dataclass
class CodecTraffic:
    """What came from robots and went to viewers in one codec."""

    frames_in: int = 0
    bytes_in: int = 0
    frames_out: int = 0
    bytes_out: int = 0


class FeedTraffic:
    """What all feeds have passed on since the start; `metrics` reads it."""

    def __init__(self) -> None:
        self.by_codec = {name: CodecTraffic() for name in NAMES}
        # Of frames as they come from robots.
        self.frame_ages = TimeHistogram()
        self.skipped = 0


class Viewer(CopyUser, Protocol):
    """Somebody who follows a feed."""

    @property
    def stream_request(self) -> StreamRequest | None:
        """What it wants to see; None: it has not said so yet."""

    @property
    def is_recorder(self) -> bool:
        """Whether it takes what is sent to others: it wants nothing more, and sets no pace, while there are any."""

    @property
    def may_drive(self) -> bool:
        """Whether it may drive the robot."""

    @property
    def round_trip_s(self) -> float:
        """The shortest time in which it took a frame; 0 before it took any."""

    def notify(self) -> None:
        """There is a newer frame, or another status; must not wait."""

    def end(self, close_reason: CloseReason) -> None:
        """The feed is over."""


class FeedKey(NamedTuple):
    """A camera, and whether it is the feed for those who decode H.264."""

    camera: str
    decodes_h264: bool = True


class Feed(SharedCopy[FeedKey, Viewer]):
    """The newest frames of one camera of one robot, and its viewers.

    `watched` lists the camera's feeds that operators follow, the one that goes first at the front; `driver_id` says who
    drives the robot.
    """

    def __init__(
        self,
        robot: RelayRobot,
        key: FeedKey,
        traffic: FeedTraffic,
        counts: CameraCounts,
        watched: Callable[[], Sequence[Feed]] = tuple,
        *,
        driver_id: Callable[[], int | None] = lambda: None,
    ) -> None:
        super().__init__(robot, key)
        self.held = HeldFrames()
        # A viewer can decode nothing before a key frame.
        self.needs_key_frame = False
        self.status: VideoStatus | None = None
        # None as long as nobody knows whether the robot has such a service; then why it has not.
        self.opened: asyncio.Future[CloseReason | None] = asyncio.get_running_loop().create_future()
        # Something is to be sent to the robot.
        self.due = asyncio.Event()
        self._traffic = traffic
        self._counts = counts
        self._watched = watched
        self._driver_id = driver_id
        self._credits = Credits()
        # The shortest time in which the robot answered on this connection.
        self._round_trip_s = 0.0
        # What the robot's numbers lack to ours, which continue when its agent restarts.
        self._shift: int | None = 0

    @property
    def newest(self) -> Frame | None:
        """The frame that came last."""
        return self.held.newest

    def join(self, viewer: Viewer) -> None:
        """Notify this viewer of what is new."""
        if not self.users:
            self._credits.forget()
        self.users.add(viewer)
        self.due.set()

    def leave(self, viewer: Viewer) -> None:
        """Notify it no more."""
        self.users.discard(viewer)
        self.due.set()

    def end(self, close_reason: CloseReason) -> None:
        """Notify all viewers that it is over."""
        if not self.opened.done():
            self.opened.set_result(close_reason)
        for viewer in list(self.users):
            viewer.end(close_reason)

    def taken(self, sequence: int) -> None:
        """A viewer has this frame, or waits for one after it; the quickest counts."""
        if self._credits.on_taken(sequence):
            self.due.set()

    def request_key_frame(self) -> None:
        """Have the robot asked for a key frame; many requests are one."""
        if not self.needs_key_frame:
            self.needs_key_frame = True
            self.due.set()

    @property
    def has_operators(self) -> bool:
        """Whether somebody else than the recorder follows it."""
        return any(not viewer.is_recorder for viewer in self.users)

    @property
    def has_decoders(self) -> bool:
        """Whether an operator follows it who decodes H.264."""
        return any(decodes_h264(viewer) for viewer in self.users if not viewer.is_recorder)

    @property
    def lacks_encoder(self) -> bool:
        """Whether the robot sends JPEG although H.264 is requested, and not only until its encoder has started."""
        status = self.status
        if self.newest is None or self.newest.codec is not JPEG or status is None:
            return False
        # An encoder at work has refused one frame.
        return status.encoder is None and status.no_encoder not in ("", ENCODER_STARTS)

    def worth(self, driver_id: int | None) -> tuple[bool, bool]:
        """Return what decides which of a camera's feeds goes first: whether its driver follows it, or who may drive."""
        return driver_id in self.user_ids(), any(viewer.may_drive for viewer in self.users)

    def fresh(self, now_s: float) -> bool:
        """Return whether the newest frame is fresh enough for a new viewer."""
        return self.newest is not None and now_s - self.newest.received_s < FRESH_S

    def sent(self, frame: Frame, skipped: int) -> None:
        """Count a frame that a viewer was sent, and the `skipped` ones before it."""
        traffic = self._traffic.by_codec[frame.codec.name]
        traffic.frames_out += 1
        traffic.bytes_out += len(frame.message)
        self._traffic.skipped += skipped

    def stream_request(self) -> StreamRequest | None:
        """What all viewers want together; the recorder only while it is alone.

        Beside H.264 of the camera it is JPEG, as a robot has one encoder a camera, and little unless it goes first.
        """
        request, watched = self._combined_request(), self._watched()
        if (
            request is None
            or self.key.decodes_h264
            or not any(feed.key.decodes_h264 for feed in watched)
        ):
            return request
        request = replace(request, codecs=(JPEG.name,))
        if watched[0] is self:
            return request
        return replace(request, fps=min(request.fps, YIELDING_FPS), yields=True)

    def _combined_request(self) -> StreamRequest | None:
        viewers = [viewer for viewer in self.users if viewer.stream_request is not None]
        operators = _operators_of(viewers)
        requests = _requests_of(operators)
        if not requests:
            return None
        # An observer takes nothing from a driver, nor does a camera that the driver does not see.
        driver_id = self._driver_id()
        is_driven = driver_id in self.user_ids()
        leading = _requests_of(each for each in operators if each.may_drive or not is_driven)
        # Viewers that do not decode H.264 are here while the robot has no encoder.
        choosing = [each for each in requests if H264.name in each.codecs] or requests
        request, codecs = reduce(combined, leading), reduce(combined, choosing).codecs
        return replace(
            request,
            codecs=codecs,
            latency_ms=reached_latency_ms(request.latency_ms, self._way_s()),
            yields=driver_id is not None and not is_driven,
        )

    def _way_s(self) -> float:
        """Return the shortest time to the robot and back, and to the viewer that sets the pace and back."""
        ways_s = (viewer.round_trip_s for viewer in _operators_of(self.users))
        return self._round_trip_s + min(ways_s, default=0.0)

    def on_connected(self) -> None:
        """There is a new connection to the robot, on which nothing is open yet."""
        self._credits.restart()
        self._round_trip_s = 0.0
        # The robot begins with a key frame by itself.
        self.held.break_chain()
        self.needs_key_frame = False
        self._shift = 0 if self.newest is None else None
        if not self.opened.done():
            self.opened.set_result(None)

    def credit(self) -> tuple[int, int | None] | None:
        """Take what credit is to be given now, with the robot's own number of the newest that was taken."""
        frames, taken = self._credits.grant(self._way_s()), self._credits.taken
        if not frames:
            return None
        return frames, None if taken is None else (taken - (self._shift or 0)) % SEQUENCES

    def on_frame(self, data: bytes, now_s: float, clock: SenderClock) -> None:
        """A frame came, with a timestamp on the robot's clock."""
        codec, sequence, timestamp_ms = parse_frame(data)
        self._credits.on_frame(now_s, is_encoded=depends_on_earlier(codec))
        self._round_trip_s = clock.round_trip_s
        timestamp_s = clock.ours(now_s, timestamp_ms)
        if self._shift is None:
            last = 0 if self.newest is None else self.newest.sequence
            self._shift = (last + 1 - sequence) % SEQUENCES
        sequence = (sequence + self._shift) % SEQUENCES
        self._credits.await_taken(sequence)
        if codec not in CODECS or timestamp_s is None:
            # Nobody here can show it, or know how old it is.
            self.held.break_chain()
            self.taken(sequence)
            return
        position = 0 if self.newest is None else self.newest.position + 1
        frame = Frame(
            data, sequence=sequence, position=position, timestamp_s=timestamp_s, received_s=now_s
        )
        self._hold(frame)

    def _hold(self, frame: Frame) -> None:
        traffic = self._traffic.by_codec[frame.codec.name]
        size = frame.size + HEADER.size
        traffic.frames_in += 1
        traffic.bytes_in += size
        self._counts.frames += 1
        self._counts.bytes += size
        self._traffic.frame_ages.add(frame.received_s - frame.timestamp_s)
        if not self.held.add(frame):
            # Nobody can decode it; and without credit the key frame could not come.
            self.request_key_frame()
            self.taken(frame.sequence)
            return
        if frame.is_key:
            self.needs_key_frame = False
        self._notify()

    def on_status(self, status: VideoStatus) -> None:
        """The robot reported how its source is."""
        self.status = status
        self._notify()

    def _notify(self) -> None:
        for viewer in list(self.users):
            self._notify_one(viewer)

    def _notify_one(self, viewer: Viewer) -> None:
        try:
            viewer.notify()
        except Exception:
            # One viewer's defect must not cost the others their frames.
            log.exception("robot %s: a viewer failed", self.robot.name)
            viewer.end(close_reasons.relay_failed())


def reached_latency_ms(requested_ms: float, way_s: float) -> float:
    """Return the latency to ask for, given the shortest time for a frame and its confirmation."""
    over_ms = way_s * 1000 - WAY_PART * requested_ms
    steps = max(0, ceil(over_ms / WAY_STEP_MS))
    return min(LATENCIES_MS[1], requested_ms + steps * WAY_STEP_MS)


def _operators_of(viewers: Collection[Viewer]) -> Collection[Viewer]:
    """Return those whose wishes count: the recorder's do while it is alone."""
    return [viewer for viewer in viewers if not viewer.is_recorder] or viewers


def _requests_of(viewers: Iterable[Viewer]) -> list[StreamRequest]:
    requests = (viewer.stream_request for viewer in viewers)
    return [request for request in requests if request is not None]


def decodes_h264(viewer: Viewer) -> bool:
    """Return whether a viewer says that it decodes H.264."""
    request = viewer.stream_request
    return request is not None and H264.name in request.codecs


RunFeed = Callable[[Feed], Awaitable[CloseReason]]


class Feeds(SharedCopies[Feed]):
    """All feeds, by robot and topic. `run` brings a feed its frames until there are no more, and returns why."""

    def __init__(self, registry: SessionRegistry, run: RunFeed) -> None:
        super().__init__(registry, attrgetter("feeds"), max_lingering=MAX_LINGERING)
        self.traffic = FeedTraffic()
        self._run_feed = run

    def follow(self, robot: RelayRobot, key: FeedKey, viewer: Viewer) -> Feed:
        """Have a viewer follow a feed until it leaves."""
        feed = self._of(robot.id).get(key) or self._open(self._new(robot, key))
        feed.join(viewer)
        self._wake(feed)
        return feed

    def leave(self, feed: Feed, viewer: Viewer) -> None:
        """Have a viewer follow a feed no more; the last one's end closes it."""
        feed.leave(viewer)
        self._wake(feed)
        self._let_linger(feed)

    def key_for(self, robot: RelayRobot, camera: str, viewer: Viewer) -> FeedKey:
        """Return which feed is a viewer's: that of what it decodes.

        Viewers that do not decode H.264 share the other feed's JPEGs if the robot has no encoder, or nobody decodes
        H.264. The recorder follows the feed that goes first, which the driver sees.
        """
        if not viewer.is_recorder:
            return FeedKey(camera, decodes_h264(viewer) or self._gives_jpeg(robot.id, camera))
        watched = self._watched(robot.id, camera)
        return watched[0].key if watched else FeedKey(camera)

    def _gives_jpeg(self, robot_id: int, camera: str) -> bool:
        """Whether the feed for H.264 has JPEGs."""
        feed = self._of(robot_id).get(FeedKey(camera))
        return feed is not None and (
            feed.lacks_encoder or (feed.has_operators and not feed.has_decoders)
        )

    def _new(self, robot: RelayRobot, key: FeedKey) -> Feed:
        counts = self._registry.ensure_robot(robot.id).camera_counts
        watched = partial(self._watched, robot.id, key.camera)
        driver_id = partial(self._driver_id, robot.id)
        return Feed(robot, key, self.traffic, counts, watched, driver_id=driver_id)

    def _of_camera(self, robot_id: int, camera: str) -> list[Feed]:
        feeds = self._of(robot_id)
        keys = (FeedKey(camera), FeedKey(camera, decodes_h264=False))
        return [feeds[key] for key in keys if key in feeds]

    def _watched(self, robot_id: int, camera: str) -> list[Feed]:
        """List the feeds of a camera that operators follow, the one that goes first at the front."""
        driver_id = self._driver_id(robot_id)
        feeds = [feed for feed in self._of_camera(robot_id, camera) if feed.has_operators]
        return sorted(feeds, key=lambda feed: feed.worth(driver_id), reverse=True)

    def _driver_id(self, robot_id: int) -> int | None:
        """Return which user drives the robot; None: nobody, or a route."""
        driver = self._registry.robot(robot_id).lease.driver
        return None if driver is None or driver.holder.is_route else driver.holder.user_id

    def _wake(self, feed: Feed) -> None:
        """Have the robot told what the camera's other feed may take now."""
        for each in self._of_camera(feed.robot.id, feed.key.camera):
            each.due.set()

    def _on_link_lost(self, copy: Feed) -> None:
        copy.end(close_reasons.link_lost(copy.robot.name))

    async def _bring(self, copy: Feed) -> None:
        name = copy.robot.name
        try:
            close_reason = await self._run_feed(copy)
            log.info(
                "robot %s: feed of %r ended: %s", name, copy.key.camera[:100], close_reason.reason
            )
        except Exception:
            log.exception("robot %s: a feed failed", name)
            close_reason = close_reasons.relay_failed()
        copy.end(close_reason)

"""What all viewers of robots' cameras share: limits, rights, and the next frame.

`video`, `streams` and `frames_handler` let their viewers in here. Each is cut when its link, right or login ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from aiohttp import web

from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import FieldInvalidError
from robotether_server.relay.auth.access import HandlerContext, Permit
from robotether_server.relay.channels.video.feeds import Feed, FeedKey, Feeds, Viewer
from robotether_server.relay.channels.video.frame_protocol import Frame
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.robots.connection import Connection

MAX_TOPIC = 255


@dataclass(frozen=True)
class VideoContext(HandlerContext):
    """What the handlers of video need besides."""

    feeds: Feeds


def connection_of(permit: Permit, camera: str, end: Callable[[CloseReason], None]) -> Connection:
    """Return the connection that a viewer of this camera counts as; no camera: an empty text."""
    return Connection(
        permit.user.id,
        permit.user.name,
        permit.robot,
        "video",
        end,
        level=permit.level,
        connected=True,
        camera=camera,
        may_drive=permit.may_drive,
    )


@contextmanager
def counted(context: VideoContext, permit: Permit, connection: Connection) -> Iterator[None]:
    """Count a viewer inside the block, have it ended when it may see no more, and the robot send video."""
    robot = context.registry.ensure_robot(permit.robot.id)
    with context.counted(connection, permit.credential), robot.media_demand.counted():
        yield


class Cursor:
    """Which frame of a feed one viewer gets next, so that it can decode each one that it gets.

    Of JPEG the newest; of a codec that depends on earlier frames each in its turn, from a key frame on.
    """

    def __init__(self, feed: Feed, viewer: Viewer, now_s: float) -> None:
        self.feed = feed
        self._viewer = viewer
        # Positions of the frame that was sent last, and of the one that is next if none is skipped.
        self._sent = -1
        self._next = 0
        # The viewer can decode what depends on the frame that was sent last.
        self._continues = False
        if (newest := feed.newest) is not None:
            # Of what came before the viewer did, what is fresh is shown at once.
            is_fresh = feed.fresh(now_s)
            self._next = newest.position + (not is_fresh)
            if not is_fresh:
                feed.taken(newest.sequence)

    def next(self) -> Frame | None:
        """Return the frame that the viewer gets next; None when it has had the newest, or must wait for a later one.

        A frame for which it cannot wait is given back: without credit the robot could send no other.
        """
        newest = self.feed.newest
        if newest is None or newest.position < self._next:
            return None
        frame = self._decodable(newest)
        if frame is None:
            self.feed.taken(newest.sequence)
        return frame

    def sent(self, frame: Frame) -> None:
        """The viewer was sent the frame."""
        self.feed.sent(frame, max(0, frame.position - self._next))
        self._sent, self._next, self._continues = frame.position, frame.position + 1, True

    def restart(self) -> None:
        """The viewer can decode nothing before a key frame."""
        self._continues = False
        if self.feed.newest is not None:
            self._decodable(self.feed.newest)

    def decodes(self, newest: Frame) -> bool:
        """Return whether the viewer decodes this frame's codec."""
        request = self._viewer.stream_request
        return request is not None and newest.codec.name in request.codecs

    def _decodable(self, newest: Frame) -> Frame | None:
        """Return the next frame, None when none can be decoded; then the robot is asked for a key frame."""
        if not self.decodes(newest):
            return None
        held = self.feed.held
        if self._continues and (frame := held.at(self._sent + 1)) is not None:
            return frame
        if (start := held.start) is not None and start.position > self._sent:
            return start
        if newest.codec.depends_on_earlier:
            self.feed.request_key_frame()
        return None


class ViewerPlace:
    """The feed of a camera that a viewer follows now, and which frame of it is next; `leave` ends it.

    Where another feed becomes the viewer's, it follows both until the other has a frame for it, so that none is
    missing.
    """

    def __init__(self, feeds: Feeds, robot: RelayRobot, camera: str, viewer: Viewer) -> None:
        self._feeds = feeds
        self._robot = robot
        self._camera = camera
        self._viewer = viewer
        self.cursor = self._follow(feeds.key_for(robot, camera, viewer))
        # Of the feed that becomes the viewer's.
        self._coming: Cursor | None = None

    @property
    def feed(self) -> Feed:
        """The feed whose frames the viewer gets now."""
        return self.cursor.feed

    def move(self) -> bool:
        """Follow the feed that is the viewer's now; return whether its frames come from another one than before."""
        key = self._feeds.key_for(self._robot, self._camera, self._viewer)
        if self._coming is not None and self._coming.feed.key != key:
            self._leave_coming()
        if key == self.feed.key:
            return False
        if self._coming is None:
            self._coming = self._follow(key)
        newest = self.feed.newest
        if self._coming.next() is None and newest is not None and self.cursor.decodes(newest):
            return False
        before, self.cursor, self._coming = self.feed, self._coming, None
        self._feeds.leave(before, self._viewer)
        return True

    def leave(self) -> None:
        """Follow nothing."""
        self._leave_coming()
        self._feeds.leave(self.feed, self._viewer)

    def _follow(self, key: FeedKey) -> Cursor:
        feed = self._feeds.follow(self._robot, key, self._viewer)
        return Cursor(feed, self._viewer, time.monotonic())

    def _leave_coming(self) -> None:
        coming, self._coming = self._coming, None
        if coming is not None:
            self._feeds.leave(coming.feed, self._viewer)


def note_sent(context: VideoContext, permit: Permit, camera: str, frame: Frame) -> None:
    """Note that a viewer is sent the frame, which it may name when it drives."""
    robot, user_id = context.registry.ensure_robot(permit.robot.id), permit.user.id
    robot.viewer_stats.count(user_id, frame.size)
    if permit.may_drive:
        robot.delivered_frames.note(user_id, camera, frame.sequence, frame.robot_sequence)


def topic_of(request: web.Request) -> str:
    """Return which camera is asked for; FieldInvalidError when none is."""
    topic: str = request.query.get("topic", "")
    if not 0 < len(topic) <= MAX_TOPIC or not topic.isprintable():
        raise FieldInvalidError(
            f"cannot open a camera: name it with topic=, in at most {MAX_TOPIC} characters"
        )
    return topic

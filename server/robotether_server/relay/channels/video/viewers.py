"""What all viewers of robots' cameras share: limits, rights, and the next frame.

`video`, `streams` and `frames_handler` let their viewers in here. Each is cut when its link, right or login ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from aiohttp import web

from robotether_server.problems import FieldInvalidError
from robotether_server.relay.auth.access import HandlerContext, Permit
from robotether_server.relay.channels.video.feeds import Feed, Feeds
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
    """Which frame of a feed one viewer gets next: the newest, if it has not had it."""

    def __init__(self, feed: Feed, now_s: float) -> None:
        self._feed = feed
        self._last = feed.newest
        # What came before the viewer did; what is fresh is shown at once.
        self._is_sent = self._last is None or not feed.fresh(now_s)
        if self._last is not None and self._is_sent:
            feed.taken(self._last.sequence)

    def next(self) -> Frame | None:
        """Return the frame that the viewer gets next, None when it has had the newest."""
        newest = self._feed.newest
        return None if newest is self._last and self._is_sent else newest

    def sent(self, frame: Frame) -> None:
        """The viewer was sent the frame."""
        before = frame.position if self._last is None else self._last.position + self._is_sent
        self._feed.sent(frame, max(0, frame.position - before))
        self._last, self._is_sent = frame, True


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

"""Answers /robots/NAME/video/stream out of a feed: multipart frames, for <img> and programs.

`video` asks here first. Such a viewer gives no credit: it is sent the newest frame whenever the system has
taken the last one, and what waits in the system is kept small.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time

from aiohttp import web
from robotether_common.frames import QOS_NAME, StreamRequest

from robotether_server.problems import (
    FieldInvalidError,
    NoFramesError,
    ProtocolError,
    RobotetherError,
    RobotOfflineError,
    VideoDownError,
)
from robotether_server.relay.auth.access import Permit
from robotether_server.relay.channels.video.feeds import Feed
from robotether_server.relay.channels.video.frame_protocol import Frame, parse_stream_request
from robotether_server.relay.channels.video.headers import headers_of_stream
from robotether_server.relay.channels.video.viewers import (
    Cursor,
    VideoContext,
    note_sent,
    topic_of,
)
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.sockets import keep_little_unsent

log = logging.getLogger(__name__)

VIEWER_SLOW_AFTER_S = 10.0
FIRST_FRAME_WITHIN_S = 8.0
# A robot that knew it could write a part of any kind into a frame.
BOUNDARY = secrets.token_hex(16)
# What web_video_server does to its own stream and no feed can: such a stream is passed through.
CHANGES_FRAME = frozenset({"default_transport", "invert", QOS_NAME})


def is_for_feed(request: web.Request) -> bool:
    """Return whether a feed can answer the request."""
    query = request.query
    return (
        request.match_info.get("path") == "stream"
        and query.get("type", "mjpeg") == "mjpeg"
        and "topic" in query
        and not CHANGES_FRAME & query.keys()
    )


class StreamViewer:
    """Who follows a feed for a multipart answer."""

    def __init__(self, user_id: int, stream_request: StreamRequest) -> None:
        self._user_id = user_id
        self.stream_request = stream_request
        self.close_reason: CloseReason | None = None
        self._changed = asyncio.Event()

    def user_ids(self) -> tuple[int]:
        """Return whose it is."""
        return (self._user_id,)

    def notify(self) -> None:
        """The feed has something new."""
        self._changed.set()

    def end(self, close_reason: CloseReason) -> None:
        """The feed is over."""
        self.close_reason = self.close_reason or close_reason
        self._changed.set()

    async def next(self, cursor: Cursor) -> Frame | None:
        """Wait for a frame that was not sent yet; None when there are no more."""
        while self.close_reason is None:
            if (frame := cursor.next()) is not None:
                return frame
            await self._changed.wait()
            self._changed.clear()
        return None


class Streams:
    """Writes feeds as multipart answers."""

    def __init__(self, context: VideoContext) -> None:
        self._context = context

    async def show(
        self, request: web.Request, permit: Permit, *, embeddable: bool
    ) -> web.StreamResponse | None:
        """Answer until either side ends; None when the robot has no frames service."""
        robot, user = permit.robot, permit.user
        viewer = StreamViewer(user.id, stream_request_of(request))
        with (
            self._context.feeds.followed(robot, topic_of(request), viewer) as feed,
            self._context.registry.ensure_robot(robot.id).viewer_stats.viewing(user.id),
        ):
            cursor = Cursor(feed, viewer, time.monotonic())
            first = await self._first(feed, viewer, cursor)
            if first is None:
                return None
            session = StreamSession(self._context, permit, feed, viewer, cursor)
            return await session.answer(request, first, headers_of_stream(embeddable=embeddable))

    async def _first(self, feed: Feed, viewer: StreamViewer, cursor: Cursor) -> Frame | None:
        """Wait for the first frame; None when the robot has no frames service."""
        robot = feed.robot.name
        try:
            async with asyncio.timeout(FIRST_FRAME_WITHIN_S):
                frame = await viewer.next(cursor)
        except TimeoutError as exc:
            detail = "" if feed.status is None else feed.status.detail
            why = detail or f"its camera sent no frame in {FIRST_FRAME_WITHIN_S:g} s"
            raise NoFramesError(f"cannot show video of robot {robot}: {why}") from exc
        if frame is None and viewer.close_reason != close_reasons.frames_unknown(robot):
            raise _problem_of(robot, viewer.close_reason)
        return frame


class StreamSession:
    """One answer from its first frame on."""

    def __init__(
        self,
        context: VideoContext,
        permit: Permit,
        feed: Feed,
        viewer: StreamViewer,
        cursor: Cursor,
    ) -> None:
        self._context = context
        self._permit = permit
        self._feed = feed
        self._viewer = viewer
        self._cursor = cursor

    async def answer(
        self, request: web.Request, frame: Frame | None, headers: dict[str, str]
    ) -> web.StreamResponse:
        """Write frames until either side ends."""
        kind = f"multipart/x-mixed-replace;boundary={BOUNDARY}"
        response = web.StreamResponse(headers={"Content-Type": kind, **headers})
        response.force_close()
        writer = await response.prepare(request)
        if request.method != "GET" or writer is None or request.transport is None:
            return response
        keep_little_unsent(request.transport)
        try:
            await response.write(f"--{BOUNDARY}\r\n".encode())
            while frame is not None:
                self._cursor.sent(frame)
                note_sent(self._context, self._permit, self._feed.key, frame)
                async with asyncio.timeout(VIEWER_SLOW_AFTER_S):
                    await response.write(frame.part(BOUNDARY, time.time() - time.monotonic()))
                    await writer.drain()
                self._feed.taken(frame.sequence)
                frame = await self._viewer.next(self._cursor)
        except (ConnectionError, TimeoutError):
            log.info("robot %s: a stream's viewer did not take it", self._permit.robot.name)
        # The answer has no end of its own, and the viewer must not take it for whole.
        if request.transport is not None:
            request.transport.abort()
        return response


def stream_request_of(request: web.Request) -> StreamRequest:
    """Read out of a stream's query what is wanted; a quality is the best, and less on a narrow link."""
    members: dict[str, object] = {}
    names = {"quality": "quality_max", "width": "width", "height": "height"}
    try:
        for name, member in names.items():
            if name in request.query:
                members[member] = int(request.query[name])
        members["quality_min"] = min(
            StreamRequest().quality_min, int(request.query.get("quality", "100"))
        )
        return parse_stream_request(members)
    except (ValueError, ProtocolError) as exc:
        raise FieldInvalidError(
            "cannot show a stream: quality is 1 to 100, width and height go together, in pixels up to 4096"
        ) from exc


def _problem_of(robot: str, close_reason: CloseReason | None) -> RobotetherError:
    reason = "it ended" if close_reason is None else close_reason.reason
    away = close_reason is not None and close_reason.name in {"robot_offline", "link_lost"}
    return (RobotOfflineError if away else VideoDownError)(f"cannot show video: {reason}")

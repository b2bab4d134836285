"""Answers /robots/NAME/video/stream out of a feed: multipart pictures, for <img> and programs.

`video` asks here first. Such a viewer gives no credit: it is sent the newest picture whenever the system has
taken the last one, and what waits in the system is kept small.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time

from aiohttp import web

from robotether_server.problems import FieldInvalid, Problem, RobotOffline, VideoDown
from robotether_server.relay import endings
from robotether_server.relay.access import Permit
from robotether_server.relay.endings import Ending
from robotether_server.relay.feeds import Feed
from robotether_server.relay.means import Means
from robotether_server.relay.pictures import BrokenFramesError, Picture, Want, parse_want
from robotether_server.relay.sockets import keep_little_unsent
from robotether_server.relay.video_headers import headers_of_stream
from robotether_server.relay.viewers import Cursor, topic_of

log = logging.getLogger(__name__)

VIEWER_SLOW_AFTER_S = 10.0
FIRST_PICTURE_WITHIN_S = 10.0
# A robot that knew it could write a part of any kind into a picture.
BOUNDARY = secrets.token_hex(16)
# What web_video_server does to its own stream and no feed can: such a stream is passed through.
CHANGES_PICTURE = frozenset({"default_transport", "invert", "qos_profile"})


def is_for_feed(request: web.Request) -> bool:
    """Tell whether a feed can answer the request."""
    query = request.query
    return (
        request.match_info.get("path") == "stream"
        and query.get("type", "mjpeg") == "mjpeg"
        and "topic" in query
        and not CHANGES_PICTURE & query.keys()
    )


class StreamViewer:
    """Who follows a feed for a multipart answer."""

    def __init__(self, want: Want) -> None:
        self.want = want
        self.ending: Ending | None = None
        self._news = asyncio.Event()

    def news(self) -> None:
        """The feed has something new."""
        self._news.set()

    def end(self, ending: Ending) -> None:
        """The feed is over."""
        self.ending = self.ending or ending
        self._news.set()

    async def next(self, cursor: Cursor) -> Picture | None:
        """Wait for a picture that was not sent yet; None when there are no more."""
        while self.ending is None:
            if (picture := cursor.next()) is not None:
                return picture
            await self._news.wait()
            self._news.clear()
        return None


class Streams:
    """Writes feeds as multipart answers."""

    def __init__(self, means: Means) -> None:
        self._means = means

    async def show(
        self, request: web.Request, permit: Permit, *, embeddable: bool
    ) -> web.StreamResponse | None:
        """Answer until either side ends; None when the robot has no frames service."""
        robot, user = permit.robot, permit.user
        viewer = StreamViewer(want_of(request))
        with (
            self._means.feeds.followed(robot, topic_of(request), viewer) as feed,
            self._means.deliveries.viewing(robot.id, user.id),
        ):
            cursor = Cursor(feed, time.monotonic())
            first = await self._first(feed, viewer, cursor)
            if first is None:
                return None
            visit = _Visit(self._means, permit, feed, viewer, cursor)
            return await visit.answer(request, first, headers_of_stream(embeddable=embeddable))

    async def _first(self, feed: Feed, viewer: StreamViewer, cursor: Cursor) -> Picture | None:
        """Wait for the first picture; None when the robot has no frames service."""
        robot = feed.robot.name
        try:
            async with asyncio.timeout(FIRST_PICTURE_WITHIN_S):
                picture = await viewer.next(cursor)
        except TimeoutError as exc:
            detail = "" if feed.status is None else f": {feed.status['detail']}"
            why = f"its camera gave no picture in {FIRST_PICTURE_WITHIN_S:g} s{detail}"
            raise VideoDown(f"cannot show video of robot {robot}: {why}") from exc
        if picture is None and viewer.ending != endings.frames_unknown(robot):
            raise _problem_of(robot, viewer.ending)
        return picture


class _Visit:
    """One answer from its first picture on."""

    def __init__(
        self, means: Means, permit: Permit, feed: Feed, viewer: StreamViewer, cursor: Cursor
    ) -> None:
        self._means = means
        self._permit = permit
        self._feed = feed
        self._viewer = viewer
        self._cursor = cursor

    async def answer(
        self, request: web.Request, picture: Picture | None, headers: dict[str, str]
    ) -> web.StreamResponse:
        kind = f"multipart/x-mixed-replace;boundary={BOUNDARY}"
        response = web.StreamResponse(headers={"Content-Type": kind, **headers})
        response.force_close()
        writer = await response.prepare(request)
        if request.method != "GET" or writer is None or request.transport is None:
            return response
        keep_little_unsent(request.transport)
        try:
            await response.write(f"--{BOUNDARY}\r\n".encode())
            while picture is not None:
                self._cursor.sent(picture)
                async with asyncio.timeout(VIEWER_SLOW_AFTER_S):
                    await response.write(picture.part(BOUNDARY, time.time() - time.monotonic()))
                    await writer.drain()
                self._count(picture)
                picture = await self._viewer.next(self._cursor)
        except (ConnectionError, TimeoutError):
            log.info("robot %s: a stream's viewer did not take it", self._permit.robot.name)
        # The answer has no end of its own, and the viewer must not take it for whole.
        if request.transport is not None:
            request.transport.abort()
        return response

    def _count(self, picture: Picture) -> None:
        self._feed.taken(picture.number)
        robot, user = self._permit.robot, self._permit.user
        self._means.deliveries.count(robot.id, user.id, picture.size)


def want_of(request: web.Request) -> Want:
    """Read out of a stream's query what is wanted; a quality is the best, and less on a narrow link."""
    asked: dict[str, object] = {}
    names = {"quality": "quality_max", "width": "width", "height": "height"}
    try:
        for name, member in names.items():
            if name in request.query:
                asked[member] = int(request.query[name])
        asked["quality_min"] = min(Want().quality_min, int(request.query.get("quality", "100")))
        return parse_want(asked)
    except (ValueError, BrokenFramesError) as exc:
        raise FieldInvalid(
            "cannot show a stream: quality is 1 to 100, width and height go together, in pixels up to 4096"
        ) from exc


def _problem_of(robot: str, ending: Ending | None) -> Problem:
    reason = "it ended" if ending is None else ending.reason
    away = ending is not None and ending.name in {"robot_offline", "link_lost"}
    return (RobotOffline if away else VideoDown)(f"cannot show video: {reason}")

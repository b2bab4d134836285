"""Answers /robots/NAME/video/...: streams from a robot's web_video_server as it is, or out of a feed.

The robot gets nothing that identifies the viewer: neither cookie nor ticket nor token. The viewer's browser gets only
frames from the robot, as `headers` decides: a robot's page could otherwise act on our site in its viewer's name. The
socket buffers of both sides bound the bytes on the way. `frames_handler` answers /video/frames.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from urllib.parse import parse_qsl

from aiohttp import ClientConnectorError, ClientError, ClientResponse, ClientTimeout, web
from robotether_common.frames import MAX_SIDE, QOS, QOS_NAME, no_frames
from yarl import URL

from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import (
    FieldInvalidError,
    NoFramesError,
    TooManyConnectionsError,
    VideoDownError,
)
from robotether_server.relay.auth.access import Permit, request_of
from robotether_server.relay.channels.video.headers import (
    check_destination,
    headers_for_robot,
    headers_for_viewer,
)
from robotether_server.relay.channels.video.streams import is_for_feed, show_stream
from robotether_server.relay.channels.video.viewers import VideoContext, connection_of, counted
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.robots.demand import OPENS_WITHIN_S, RETRY_S
from robotether_server.relay.robots.robot import Presence
from robotether_server.relay.robots.robot_dialer import connect_timeout_s

log = logging.getLogger(__name__)

VIEWER_SLOW_AFTER_S = 10.0
# Time limit for headers: web_video_server answers a snapshot with the next frame, and never without
# a publisher.
HEADERS_WITHIN_S = 8.0
# Time without data after which a stream ends; without a publisher it would stay open for ever.
SILENT_AFTER_S = 30.0
# With 101 the connection would be a pipe on which anything passes, to nginx and beyond.
ANSWERS = range(200, 600)
ESCAPED_SLASH = re.compile("%2F", re.IGNORECASE)


@dataclass(frozen=True)
class VideoHandler:
    """Answers /robots/NAME/video/..."""

    context: VideoContext

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Answer one request until either side ends."""
        check_destination(request.headers)
        access_request = request_of(request)
        permit = await self.context.access.for_video(access_request, request.match_info["name"])

        def cut(_why: CloseReason | None = None) -> None:
            # aiohttp cancels the handler of a connection that is gone.
            if request.transport is not None:
                request.transport.abort()

        # A ticket is what a page of another site asks with, which may then show the frame.
        embeddable = access_request.ticket is not None
        connection = connection_of(permit, request.query.get("topic", ""), cut)
        if (why := self.context.connections.no_room(connection)) is not None:
            raise TooManyConnectionsError(f"cannot show video of robot {permit.robot.name}: {why}")
        with counted(self.context, permit, connection):
            return await self._answer(request, permit, embeddable=embeddable)

    async def _answer(
        self, request: web.Request, permit: Permit, *, embeddable: bool
    ) -> web.StreamResponse:
        presence = self.context.registry.online_presence(permit.robot)
        if is_for_feed(request):
            answer = await show_stream(self.context, request, permit, embeddable=embeddable)
            if answer is not None:
                return answer
        return await self._pass_on(request, permit, presence, embeddable=embeddable)

    async def _pass_on(
        self, request: web.Request, permit: Permit, presence: Presence, *, embeddable: bool
    ) -> web.StreamResponse:
        robot, user_ids = permit.robot, (permit.user.id,)
        async with self._asked_robot(request, robot, presence) as answer:
            headers = headers_for_viewer(
                answer.headers,
                embeddable=embeddable,
                destination=request.headers.get("Sec-Fetch-Dest", "empty"),
            )
            response = web.StreamResponse(status=answer.status, headers=headers)
            await response.prepare(request)
            if request.method == "GET":
                counter, uplink = _Counter(), self.context.registry.ensure_robot(robot.id).uplink
                with uplink.counted("video", "", counter.received_bytes, lambda: user_ids):
                    await _stream(counter.counted(answer), response, request, robot.name)
            return response

    @asynccontextmanager
    async def _asked_robot(
        self, request: web.Request, robot: RelayRobot, presence: Presence
    ) -> AsyncIterator[ClientResponse]:
        path = path_for_robot(request.rel_url.raw_path, request.rel_url.raw_query_string)
        host = self.context.dialer.tunnel_host
        url = URL(f"http://{host}:{robot.video_port}{path}", encoded=True)
        timeout = ClientTimeout(
            total=None, sock_connect=connect_timeout_s(presence), sock_read=SILENT_AFTER_S
        )
        try:
            async with asyncio.timeout(HEADERS_WITHIN_S):
                answer = await self._ask(request, url, timeout)
        except (ClientError, OSError) as exc:
            raise _no_answer(robot, presence, request.query.get("topic", ""), exc) from exc
        try:
            if answer.status not in ANSWERS:
                why = f"its web_video_server answers with status {answer.status}"
                raise VideoDownError(f"cannot show video of robot {robot.name}: {why}")
            yield answer
        finally:
            # Not `release`, which would first read a stream that has no end.
            answer.close()

    async def _ask(self, request: web.Request, url: URL, timeout: ClientTimeout) -> ClientResponse:
        """Ask the robot, whose media connection may open only for this."""
        deadline_s = time.monotonic() + OPENS_WITHIN_S
        while True:
            try:
                return await self.context.dialer.client.request(
                    request.method,
                    url,
                    headers=headers_for_robot(request.headers),
                    allow_redirects=False,
                    timeout=timeout,
                )
            except ClientConnectorError:
                if time.monotonic() > deadline_s:
                    raise
            await asyncio.sleep(RETRY_S)


def path_for_robot(raw_path: str, raw_query: str) -> str:
    """Return what the robot is asked for: less our prefix, less what is for us, and with its slashes as they are.

    web_video_server undoes no escapes, and finds no topic under %2Fcamera, which many clients write. A request for a
    topic without a QoS gets that of sensors. No size takes more memory of the robot than a large picture does.
    """
    _check_sizes(raw_query)
    _, _, _, _, *rest = raw_path.split("/", 4)
    path = "/" + "".join(rest)
    parts = [part for part in raw_query.split("&") if part and not _names(part, "ticket", "mac")]
    if any(_names(part, "topic") for part in parts) and not any(
        _names(part, QOS_NAME) for part in parts
    ):
        parts.append(QOS)
    return f"{path}?{ESCAPED_SLASH.sub('/', '&'.join(parts))}" if parts else path


def _check_sizes(raw_query: str) -> None:
    for name, value in parse_qsl(raw_query, keep_blank_values=True):
        is_side = value.isascii() and value.isdecimal() and 0 < int(value[:9]) <= MAX_SIDE
        # -1 is the camera's own size.
        if name in {"width", "height"} and not is_side and value != "-1":
            raise FieldInvalidError(f"cannot show video: {name} is 1 to {MAX_SIDE} pixels", name)


def _names(part: str, *parameters: str) -> bool:
    """Return whether a part of a query has one of these names as `access` reads it: in any spelling."""
    return any(name in parameters for name, _ in parse_qsl(part, keep_blank_values=True))


def _no_answer(
    robot: RelayRobot, presence: Presence, topic: str, error: Exception
) -> VideoDownError:
    """Return why nothing was answered: where a topic has no frame, web_video_server closes or keeps the connection."""
    cannot = f"cannot show video of robot {robot.name}"
    is_down = presence.video == "down" or isinstance(error, ClientConnectorError)
    if topic and not is_down:
        return NoFramesError(f"{cannot}: {no_frames(topic)}")
    return VideoDownError(f"{cannot}: its web_video_server does not answer")


class _Counter:
    """Counts an answer's bytes. The kernel cannot: the connection of a short answer is gone before anybody asks."""

    def __init__(self) -> None:
        self._bytes = 0

    def received_bytes(self) -> int:
        """Return how much has come so far."""
        return self._bytes

    async def counted(self, answer: ClientResponse) -> AsyncIterator[bytes]:
        """Yield the chunks of an answer."""
        async for chunk in answer.content.iter_any():
            self._bytes += len(chunk)
            yield chunk


async def _stream(
    chunks: AsyncIterator[bytes], response: web.StreamResponse, request: web.Request, robot: str
) -> None:
    try:
        async for chunk in chunks:
            async with asyncio.timeout(VIEWER_SLOW_AFTER_S):
                await response.write(chunk)
    except (ClientError, ConnectionError, TimeoutError) as exc:
        # The text may hold what the robot sent.
        log.info("robot %s: video ended: %r", robot, str(exc) or "the viewer did not take it")
        # The answer is cut short, and the viewer must not take it for whole.
        if request.transport is not None:
            request.transport.abort()

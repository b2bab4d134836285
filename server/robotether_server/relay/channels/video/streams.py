"""Answers /robots/NAME/video/stream out of a feed: multipart JPEGs for <img> and programs, H.264 for players.

`handler` asks here first. Such a viewer gives no credit: it gets the next frame whenever the system has taken the last
one, and few bytes wait in the system.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import web
from robotether_common.codecs import H264, JPEG, Codec
from robotether_common.frames import ENCODER_STARTS, QOS_NAME, StreamRequest

from robotether_server.problems import (
    FieldInvalidError,
    NoEncoderError,
    NoFramesError,
    ProtocolError,
    RobotetherError,
    RobotOfflineError,
    VideoDownError,
)
from robotether_server.relay.auth.access import Permit
from robotether_server.relay.channels.video.frame_protocol import Frame, parse_stream_request
from robotether_server.relay.channels.video.headers import headers_of_stream
from robotether_server.relay.channels.video.mpeg_ts import TransportStream
from robotether_server.relay.channels.video.viewers import (
    VideoContext,
    ViewerPlace,
    note_sent,
    topic_of,
)
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.sockets import keep_little_unsent

log = logging.getLogger(__name__)

VIEWER_SLOW_AFTER_S = 10.0
FIRST_FRAME_WITHIN_S = 8.0
# Time after which a player gets another key frame, which is doubled up to the maximum: it cannot ask for one, and many
# drop the first with what they read to know the stream.
KEY_FRAME_S, MAX_KEY_FRAME_S = 1.0, 10.0
# A robot that knew it could write a part of any kind into a frame.
BOUNDARY = secrets.token_hex(16)
# What web_video_server does to its own stream and no feed can: such a stream is passed through.
CHANGES_FRAME = frozenset({"default_transport", "invert", QOS_NAME})


@dataclass(frozen=True)
class StreamFormat:
    """How one answer is written: its type, the codec of its frames, what comes before them, and each frame."""

    mime_type: str
    codec: Codec
    start: bytes
    write: Callable[[Frame], bytes]


def multipart() -> StreamFormat:
    """JPEGs, each of which takes the place of the one before."""
    return StreamFormat(
        f"multipart/x-mixed-replace;boundary={BOUNDARY}",
        JPEG,
        f"--{BOUNDARY}\r\n".encode(),
        lambda frame: frame.part(BOUNDARY, time.time() - time.monotonic()),
    )


def transport_stream() -> StreamFormat:
    """H.264 as players read it."""
    stream = TransportStream()
    return StreamFormat(
        "video/mp2t",
        H264,
        b"",
        lambda frame: stream.write(frame.data, frame.timestamp_s, is_key=frame.is_key),
    )


FORMATS = {JPEG.name: multipart, H264.name: transport_stream}


def is_for_feed(request: web.Request) -> bool:
    """Return whether a feed answers the request, or nobody does."""
    query = request.query
    return request.match_info.get("path") == "stream" and (
        "codec" in query
        or (
            query.get("type", "mjpeg") == "mjpeg"
            and "topic" in query
            and not CHANGES_FRAME & query.keys()
        )
    )


class StreamViewer:
    """The follower of a feed for a stream."""

    is_recorder = False
    # It takes a frame as soon as the system does.
    round_trip_s = 0.0

    def __init__(self, permit: Permit, stream_request: StreamRequest) -> None:
        self._user_id = permit.user.id
        self.may_drive = permit.may_drive
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

    async def next(self, place: ViewerPlace) -> Frame | None:
        """Wait for a frame that was not sent yet; None when there are no more."""
        while self.close_reason is None:
            place.move()
            if (frame := place.cursor.next()) is not None:
                return frame
            await self.changed()
        return None

    async def changed(self) -> None:
        """Wait for what the feed has new."""
        await self._changed.wait()
        self._changed.clear()


async def show_stream(
    context: VideoContext, request: web.Request, permit: Permit, *, embeddable: bool
) -> web.StreamResponse | None:
    """Write a feed as a stream until either side ends; None when the robot has no frames service."""
    robot, user = permit.robot, permit.user
    stream_format = format_of(request)
    viewer = StreamViewer(permit, stream_request_of(request, stream_format.codec))
    stats = context.registry.ensure_robot(robot.id).viewer_stats
    place = ViewerPlace(context.feeds, robot, topic_of(request), viewer)
    try:
        with stats.viewing(user.id):
            first = await FirstFrame(place, viewer, stream_format.codec).wait()
            if first is None:
                return None
            session = StreamSession(context, permit, place, viewer)
            headers = {
                "Content-Type": stream_format.mime_type,
                **headers_of_stream(embeddable=embeddable),
            }
            return await session.answer(request, first, headers, stream_format)
    finally:
        place.leave()


class FirstFrame:
    """Waits for a stream's first frame, or for the reason why there is none."""

    def __init__(self, place: ViewerPlace, viewer: StreamViewer, codec: Codec) -> None:
        self._place = place
        self._viewer = viewer
        self._codec = codec
        self._other_codec: Codec | None = None

    async def wait(self) -> Frame | None:
        """Return the first frame; None when the robot has no frames service, but may show its video without one."""
        try:
            async with asyncio.timeout(FIRST_FRAME_WITHIN_S):
                frame = await self._next()
        except TimeoutError as exc:
            raise self._no_frame() from exc
        robot, close_reason = self._place.feed.robot.name, self._viewer.close_reason
        if frame is None and close_reason != close_reasons.frames_unknown(robot):
            raise _problem_of(robot, close_reason)
        if frame is None and self._codec is not JPEG:
            raise self._no_encoder("it sends no frames; upgrade its agent")
        return frame

    async def _next(self) -> Frame | None:
        """Wait for a frame of the codec; a robot may begin with JPEG."""
        while True:
            frame = await self._viewer.next(self._place)
            if frame is None or frame.codec is self._codec:
                return frame
            if why := self._why_other_codec():
                raise self._no_encoder(why)
            self._other_codec = frame.codec
            self._place.feed.taken(frame.sequence)
            await self._viewer.changed()

    def _why_other_codec(self) -> str:
        status = self._place.feed.status
        if status is None or status.no_encoder == ENCODER_STARTS:
            return ""
        return status.no_encoder

    def _no_frame(self) -> RobotetherError:
        if self._other_codec is not None:
            return self._no_encoder(f"its agent sends {self._other_codec.name}")
        status = self._place.feed.status
        detail = "" if status is None else status.detail
        why = detail or f"its camera sent no frame in {FIRST_FRAME_WITHIN_S:g} s"
        return NoFramesError(f"cannot show video of robot {self._place.feed.robot.name}: {why}")

    def _no_encoder(self, why: str) -> NoEncoderError:
        robot = self._place.feed.robot.name
        return NoEncoderError(f"cannot show video of robot {robot} as {self._codec.name}: {why}")


class StreamSession:
    """One answer from its first frame on."""

    def __init__(
        self, context: VideoContext, permit: Permit, place: ViewerPlace, viewer: StreamViewer
    ) -> None:
        self._context = context
        self._permit = permit
        self._place = place
        self._viewer = viewer
        self._key_frame_s = KEY_FRAME_S
        self._key_frame_at_s = time.monotonic() + KEY_FRAME_S

    async def answer(
        self,
        request: web.Request,
        frame: Frame | None,
        headers: dict[str, str],
        stream_format: StreamFormat,
    ) -> web.StreamResponse:
        """Write frames until either side ends, or the robot goes over to another codec."""
        response = web.StreamResponse(headers=headers)
        response.force_close()
        writer = await response.prepare(request)
        if request.method != "GET" or writer is None or request.transport is None:
            return response
        keep_little_unsent(request.transport)
        try:
            if stream_format.start:
                await response.write(stream_format.start)
            while frame is not None and frame.codec is stream_format.codec:
                self._place.cursor.sent(frame)
                note_sent(self._context, self._permit, self._place.feed.key.camera, frame)
                async with asyncio.timeout(VIEWER_SLOW_AFTER_S):
                    await response.write(stream_format.write(frame))
                    await writer.drain()
                self._place.feed.taken(frame.sequence)
                self._request_key_frame(frame)
                frame = await self._viewer.next(self._place)
        except (ConnectionError, TimeoutError):
            log.info("robot %s: a stream's viewer did not take it", self._permit.robot.name)
        # The answer has no end of its own, and the viewer must not take it for whole.
        if request.transport is not None:
            request.transport.abort()
        return response

    def _request_key_frame(self, frame: Frame) -> None:
        now_s = time.monotonic()
        if frame.codec.depends_on_earlier and now_s >= self._key_frame_at_s:
            self._place.feed.request_key_frame()
            self._key_frame_s = min(MAX_KEY_FRAME_S, 2 * self._key_frame_s)
            self._key_frame_at_s = now_s + self._key_frame_s


def format_of(request: web.Request) -> StreamFormat:
    """Read out of a stream's query how it is written."""
    query = request.query
    made = FORMATS.get(query.get("codec", JPEG.name))
    if made is None or ("codec" in query and {"type", *CHANGES_FRAME} & query.keys()):
        raise FieldInvalidError(
            f"cannot show a stream: codec is {' or '.join(FORMATS)}, and goes with topic, quality, width and height"
        )
    return made()


def stream_request_of(request: web.Request, codec: Codec) -> StreamRequest:
    """Read out of a stream's query what is wanted; a quality is the best, and less on a narrow link."""
    members: dict[str, object] = {"codecs": [codec.name]}
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

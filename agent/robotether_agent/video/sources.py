"""Opens a camera's source by its name and the settings: one function a kind.

mjpeg      web_video_server's /stream, and any URL that `cameras` names; RTSP and devices by a process of their own
rosbridge  sensor_msgs/CompressedImage, a robot's own H.264 as it is, or sensor_msgs/Image by a process of its own;
           also of a camera that web_video_server cannot show

Each runs until it is cancelled or its source ends, raises SourceDownError in the latter case, and reads as fast as
frames come: the receivers drop those that they do not need, so that nothing waits in between.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import json
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NoReturn
from urllib.parse import quote

import aiohttp
from robotether_common.codecs import H264, JPEG, Codec
from robotether_common.frames import QOS, Source, StreamRequest, no_frames
from robotether_common.ros import (
    COMPRESSED,
    IMAGE_TYPE,
    RAW_IMAGE_TYPE,
    VIDEO_TYPES,
    camera_topics,
)
from yarl import URL

from robotether_agent.describe_error import describe_error
from robotether_agent.fields import JsonObject, printable
from robotether_agent.problems import DetailError
from robotether_agent.rosbridge import MAX_IMAGE_MESSAGE_BYTES, RosGraph, connected
from robotether_agent.tasks import first_of, within
from robotether_agent.video import av_messages
from robotether_agent.video.av_messages import FRAME_HEADER
from robotether_agent.video.av_process import (
    PYAV_MISSING,
    ProcessEndedError,
    av_process,
    has_pyav,
)
from robotether_agent.video.jpeg import JPEG_START
from robotether_agent.video.multipart import (
    MultipartBrokenError,
    MultipartParser,
    Part,
    boundary_of,
)
from robotether_agent.video.timestamps import (
    MAX_LAG_S,
    FrameClock,
    FramesLateError,
    now,
    stamp_of,
)
from robotether_agent.video.video_packets import NotShownError, h264_of

CONNECT_WITHIN_S = 3.0
# Time without a frame after which a source is opened again.
STALL_S = 10.0
# Time without a frame after which web_video_server's stream is opened again: it finds a later
# publisher by itself, and keeps a silent topic's streams after their viewers left.
SERVER_STALL_S = 60.0
# Interval between checks for web_video_server where both kinds of source are allowed.
RECHECK_S = 10.0
# Time without a frame after which ROS is asked whether web_video_server can show the camera.
FIRST_FRAME_S = 1.0
# Part of the interval between frames that rosbridge waits; all of it would drop every second frame
# of a camera at the requested rate.
THROTTLE = 0.75
# Time limit for the first frame of a process: it starts, connects, and waits for an RTSP camera's key frame.
PROCESS_START_S = 25.0
CAMERA_COMMAND = (sys.executable, "-m", "robotether_agent.video.camera_process")
IMAGE_COMMAND = (sys.executable, "-m", "robotether_agent.video.image_process")


@dataclass(frozen=True)
class CameraFrame:
    """One frame; both times are on the robot's clock (CLOCK_BOOTTIME), the first is what the frame shows."""

    data: bytes
    timestamp_s: float
    arrived_s: float
    is_stamped: bool = False
    codec: Codec = JPEG
    # Of a codec that depends on earlier frames: it can be shown without them.
    is_key: bool = False


@dataclass(frozen=True)
class SourceRequest:
    """What is asked of a source; equal ones share one. A quality of 0 and no size leave it to the camera."""

    topic: str
    quality: int
    width: int | None
    height: int | None
    # Frames a second, for sources that can be asked to give no more.
    fps: float
    # Whether H.264 that the robot encodes by itself comes as it is; else as JPEGs.
    passes_h264: bool = False


class SourceDownError(DetailError):
    """A source gives no frames; the message says why."""

    def __init__(self, message: str, *, answers: bool = True) -> None:
        super().__init__(message)
        # False: nothing listens where the source should be, so that another kind may be tried.
        self.answers = answers


class NotByServerError(SourceDownError):
    """web_video_server cannot show a camera, and rosbridge may: raw images, or else compressed ones."""

    def __init__(self, message: str, *, is_raw: bool) -> None:
        super().__init__(message)
        self.is_raw = is_raw


class NotJpegError(SourceDownError):
    """A camera's compressed images are no JPEGs."""


class CameraRedirectError(DetailError, aiohttp.ClientError):
    """A camera redirects to another host, which may be inside a network."""


OnFrame = Callable[[CameraFrame], None]
OnKind = Callable[[Source], None]


@dataclass(frozen=True)
class SourceSettings:
    """Where the robot's frames are, of the settings: `source` is auto, web_video_server or rosbridge."""

    video_url: str
    rosbridge_url: str
    source: str = "auto"
    # URLs by name; they may contain a login.
    cameras: Mapping[str, str] = field(default_factory=dict, repr=False)


def camera_http() -> aiohttp.ClientSession:
    """Return the session that reads cameras; it follows no redirect to another host."""
    trace = aiohttp.TraceConfig()
    trace.on_request_redirect.append(_check_redirect)
    return aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0), trace_configs=[trace])


async def _check_redirect(
    _client: object, _context: object, redirect: aiohttp.TraceRequestRedirectParams
) -> None:
    answer = redirect.response
    target = answer.headers.get("Location") or answer.headers.get("URI") or ""
    if answer.url.join(URL(target)).host != answer.url.host:
        answer.close()
        raise CameraRedirectError("it redirects to another host")


def cameras_by_rosbridge(own: Mapping[str, str]) -> list[str]:
    """Return the cameras among a robot's own topics that can be shown without web_video_server."""
    if has_pyav():
        return camera_topics(own)
    return camera_topics({name: kind for name, kind in own.items() if kind != RAW_IMAGE_TYPE})


class Sources:
    """Opens the source of any camera."""

    def __init__(
        self, http: aiohttp.ClientSession, source_settings: SourceSettings, graph: RosGraph
    ) -> None:
        self._http = http
        self._source_settings = source_settings
        self._graph = graph
        # What web_video_server could not show: whether that are raw images, and their encodings.
        self._not_by_server: dict[str, bool] = {}
        self._encodings: dict[str, str] = {}
        # Cameras whose compressed images are no JPEGs.
        self._only_raw: set[str] = set()

    async def first_camera(self) -> str | None:
        """Return the robot's first camera, or nothing where it has none; SourceDownError where nobody knows."""
        try:
            own = await self._graph.own_topics()
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            raise SourceDownError("rosapi does not say which cameras there are") from error
        by_rosbridge = self._source_settings.source == "rosbridge"
        return next(iter(cameras_by_rosbridge(own) if by_rosbridge else camera_topics(own)), None)

    def steps_quality(self, topic: str) -> bool:
        """Whether quality and size of a camera can be asked for, as far as is known."""
        return (
            topic not in self._source_settings.cameras
            and topic not in self._not_by_server
            and self._source_settings.source != "rosbridge"
        )

    def answered(self, source_request: SourceRequest) -> SourceRequest:
        """Return the request that is answered: one for a camera of the settings, which may open only once."""
        topic = source_request.topic
        if topic not in self._source_settings.cameras:
            return source_request
        return SourceRequest(topic, 0, None, None, StreamRequest.fps)

    async def run(
        self, source_request: SourceRequest, on_frame: OnFrame, on_kind: OnKind
    ) -> NoReturn:
        """Give frames, after reporting of which kind the source is; SourceDownError when there are no more."""
        url = self._source_settings.cameras.get(source_request.topic)
        if url is not None:
            on_kind("mjpeg")
            what = f"camera {source_request.topic}"
            if url.startswith("http"):
                await run_mjpeg(self._http, url, on_frame, what=what)
            await run_camera(url, on_frame, what=what)
        elif self._source_settings.source == "rosbridge":
            await self._run_rosbridge(source_request, on_frame, on_kind)
        elif self._source_settings.source == "web_video_server":
            on_kind("web_video_server")
            await self._run_server(source_request, on_frame)
        else:
            await self._run_either(source_request, on_frame, on_kind)
        raise SourceDownError("it ended")

    async def _run_rosbridge(
        self,
        source_request: SourceRequest,
        on_frame: OnFrame,
        on_kind: OnKind,
        *,
        is_raw: bool = False,
    ) -> None:
        """Use the camera's compressed images, or its raw ones if those are none, or `is_raw`."""
        on_kind("rosbridge")
        name, url = _full_name(source_request.topic), self._graph.url
        compressed, kind = await _image_topic(self._graph, name)
        has_raw = kind == RAW_IMAGE_TYPE
        if kind in VIDEO_TYPES:
            await run_video(self._graph, name, kind, source_request, on_frame)
        if is_raw or (has_raw and (compressed is None or name in self._only_raw)):
            await run_images(url, name, RAW_IMAGE_TYPE, source_request.fps, on_frame)
        if compressed is None:
            raise SourceDownError(f"rosbridge has no images of {printable(name, 100)}")
        try:
            await run_rosbridge(self._graph, compressed, IMAGE_TYPE, source_request.fps, on_frame)
        except NotJpegError as no_jpeg:
            if has_raw and not has_pyav():
                raise SourceDownError(f"{no_jpeg}; {PYAV_MISSING}") from no_jpeg
            if has_raw:
                self._only_raw.add(name)
            raise

    async def _run_server(self, source_request: SourceRequest, on_frame: OnFrame) -> None:
        video_url, topic = self._source_settings.video_url, source_request.topic
        has_frame, nothing = asyncio.Event(), no_frames(topic)

        def on_server_frame(frame: CameraFrame) -> None:
            if not has_frame.is_set():
                has_frame.set()
                self._encodings.pop(_full_name(topic), None)
            on_frame(frame)

        stream = run_mjpeg(
            self._http,
            stream_url(video_url, source_request),
            on_server_frame,
            what=f"web_video_server at {video_url}",
            # It ends the stream of a topic that it does not know, or of which it cannot convert the images.
            end=nothing,
            stall_s=SERVER_STALL_S,
        )
        try:
            await first_of(stream, self._doubt(topic, has_frame))
        except SourceDownError as down:
            if str(down) != nothing or has_frame.is_set():
                raise
            raise await self._lack_of(topic, has_ended=True) or down from down

    async def _doubt(self, topic: str, has_frame: asyncio.Event) -> None:
        """Raise why web_video_server has no frame, where ROS knows it; else its stream goes on."""
        with suppress(asyncio.TimeoutError):
            await within(FIRST_FRAME_S, has_frame.wait())
        if not has_frame.is_set() and (lack := await self._lack_of(topic)) is not None:
            raise lack
        await asyncio.Event().wait()

    async def _lack_of(self, topic: str, *, has_ended: bool = False) -> SourceDownError | None:
        """Return why web_video_server cannot show a camera, or nothing where ROS does not know."""
        name = _full_name(topic)
        with suppress(aiohttp.ClientError, OSError, asyncio.TimeoutError):
            topics = await self._graph.topics()
            if topics.get(name) != RAW_IMAGE_TYPE or not await self._graph.is_published(name):
                return _no_raw_images(name, topics)
            if has_ended:
                return NotByServerError(
                    f"web_video_server shows no images of {printable(name, 100)}, "
                    f"which have the encoding {await self._encoding_of(name)}",
                    is_raw=True,
                )
        return None

    async def _encoding_of(self, name: str) -> str:
        # Asked once: each raw image is much work for rosbridge, which also carries what drives the robot.
        if name not in self._encodings:
            async with connected(
                self._graph.url, max_message_bytes=MAX_IMAGE_MESSAGE_BYTES
            ) as rosbridge:
                await rosbridge.subscribe(name, RAW_IMAGE_TYPE, throttle_ms=1000)
                message = await within(CONNECT_WITHIN_S, rosbridge.message())
            self._encodings[name] = printable(str(message.get("encoding", "")), 40)
        return self._encodings[name]

    async def _run_either(
        self, source_request: SourceRequest, on_frame: OnFrame, on_kind: OnKind
    ) -> None:
        topic = source_request.topic
        if topic in self._not_by_server:
            await self._run_not_by_server(source_request, on_frame, on_kind)
        on_kind("web_video_server")
        try:
            await self._run_server(source_request, on_frame)
        except NotByServerError as lack:
            if lack.is_raw and not has_pyav():
                raise SourceDownError(f"{lack}; {PYAV_MISSING}") from lack
            self._not_by_server[topic] = lack.is_raw
            await self._run_not_by_server(source_request, on_frame, on_kind)
        except SourceDownError as down:
            if down.answers:
                raise
            await self._run_instead(source_request, on_frame, on_kind, down)

    async def _run_not_by_server(
        self, source_request: SourceRequest, on_frame: OnFrame, on_kind: OnKind
    ) -> None:
        """Use rosbridge for a camera that web_video_server cannot show; if that fails both are tried again."""
        is_raw = self._not_by_server[source_request.topic]
        try:
            await self._run_rosbridge(source_request, on_frame, on_kind, is_raw=is_raw)
        except SourceDownError:
            self._not_by_server.pop(source_request.topic, None)
            raise

    async def _run_instead(
        self,
        source_request: SourceRequest,
        on_frame: OnFrame,
        on_kind: OnKind,
        first: SourceDownError,
    ) -> None:
        """Use rosbridge while nothing answers where web_video_server should be."""
        try:
            await first_of(
                self._run_rosbridge(source_request, on_frame, on_kind),
                self._until_server_answers(),
            )
        except SourceDownError as down:
            on_kind("web_video_server")
            raise SourceDownError(f"{first}; {down}") from down
        raise SourceDownError("web_video_server answers again")

    async def _until_server_answers(self) -> None:
        while True:
            await asyncio.sleep(RECHECK_S)
            with suppress(aiohttp.ClientError, OSError, asyncio.TimeoutError):
                timeout = aiohttp.ClientTimeout(total=CONNECT_WITHIN_S)
                async with self._http.get(self._source_settings.video_url, timeout=timeout):
                    return


def stream_url(video_url: str, source_request: SourceRequest) -> str:
    """Return the URL of web_video_server's stream."""
    size = (
        ""
        if source_request.width is None
        else f"&width={source_request.width}&height={source_request.height}"
    )
    topic, quality = quote(source_request.topic), source_request.quality
    return f"{video_url}/stream?topic={topic}&type=mjpeg&quality={quality}{size}&{QOS}"


async def run_mjpeg(
    http: aiohttp.ClientSession,
    url: str,
    on_frame: OnFrame,
    *,
    what: str,
    end: str = "",
    stall_s: float | None = None,
) -> NoReturn:
    """Give the frames of a multipart stream; `what` names it in errors, and `end` says why it ends or stalls."""
    stall_s = STALL_S if stall_s is None else stall_s
    timeout = aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_WITHIN_S, sock_read=stall_s)
    try:
        # Encoded already; a camera's own signs stay as they are.
        async with http.get(URL(url, encoded=True), timeout=timeout) as answer:
            if answer.status != 200:  # noqa: PLR2004
                raise SourceDownError(f"{what} answers with HTTP status {answer.status}")
            parts = MultipartParser(boundary_of(answer.headers.get("Content-Type", "")))
            clock = FrameClock()
            async for data in answer.content.iter_any():
                for part in parts.feed(data):
                    _pass_part(part, clock, on_frame)
    except (aiohttp.ClientConnectorError, aiohttp.ConnectionTimeoutError) as error:
        reason = describe_error(error, CONNECT_WITHIN_S)
        raise SourceDownError(f"{what} does not answer: {reason}", answers=False) from error
    except aiohttp.ServerTimeoutError as error:
        raise SourceDownError(end or f"{what} sent no frame for {stall_s:g} s") from error
    except (FramesLateError, MultipartBrokenError, CameraRedirectError) as error:
        raise SourceDownError(f"{what} cannot be shown: {error}") from error
    except (aiohttp.ClientError, OSError, ValueError, asyncio.TimeoutError) as error:
        raise SourceDownError(f"{what} ended: {describe_error(error, stall_s)}") from error
    raise SourceDownError(end or f"{what} ended the stream")


def _pass_part(part: Part, clock: FrameClock, on_frame: OnFrame) -> None:
    if not part.body.startswith(JPEG_START):
        kind = part.headers.get("content-type", "")
        if kind.startswith("image/") and not kind.startswith("image/jp"):
            raise MultipartBrokenError(f"it sends {printable(kind, 40)}, not JPEG")
        return
    arrived = now()
    stamp: float | None = None
    with suppress(ValueError):
        stamp = float(part.headers["x-timestamp"]) if "x-timestamp" in part.headers else None
    timestamp_s, is_stamped = clock.timestamp(stamp, arrived, part.body)
    on_frame(CameraFrame(part.body, timestamp_s, arrived.robot_s, is_stamped))


async def run_camera(url: str, on_frame: OnFrame, *, what: str) -> NoReturn:
    """Give the frames of an RTSP or V4L2 camera."""
    await _run_process(CAMERA_COMMAND, f"{url}\n", on_frame, what=what, stall_s=STALL_S)


async def run_images(url: str, topic: str, kind: str, fps: float, on_frame: OnFrame) -> NoReturn:
    """Give a topic's raw images or H.264 as JPEGs of a process, which gets them from rosbridge at `url`."""
    request = {"url": url, "topic": topic, "type": kind, "how": _how(kind, fps)}
    stall_s, what = max(STALL_S, 3 / fps), printable(topic, 100)
    await _run_process(
        IMAGE_COMMAND, json.dumps(request) + "\n", on_frame, what=what, stall_s=stall_s
    )


async def run_video(
    graph: RosGraph, topic: str, kind: str, source_request: SourceRequest, on_frame: OnFrame
) -> NoReturn:
    """Give a robot's own H.264, as JPEGs where that is not requested."""
    fps = source_request.fps
    if source_request.passes_h264:
        await run_rosbridge(graph, topic, kind, fps, on_frame)
    await run_images(graph.url, topic, kind, fps, on_frame)


async def _run_process(
    command: Sequence[str], request: str, on_frame: OnFrame, *, what: str, stall_s: float
) -> NoReturn:
    """Give the frames of a process that makes JPEGs; `what` names in errors what it reads."""
    if not has_pyav():
        raise SourceDownError(f"{what} cannot be read: {PYAV_MISSING}")
    try:
        async with av_process(command) as process:
            # Not as an argument, which everybody on the robot may read.
            await process.send(request.encode())
            limit_s = PROCESS_START_S
            while True:
                message = await within(limit_s, process.message(av_messages.MAX_MESSAGE_BYTES))
                on_frame(_process_frame(message, what))
                limit_s = stall_s
    except asyncio.TimeoutError as error:
        raise SourceDownError(f"{what} sent no frame for {limit_s:g} s") from error
    except (ProcessEndedError, OSError) as error:
        raise SourceDownError(f"{what} cannot be read: {error}") from error


def _process_frame(message: bytes, what: str) -> CameraFrame:
    try:
        kind, is_stamped, timestamp_s, arrived_s = FRAME_HEADER.unpack_from(message)
    except struct.error as error:
        raise ProcessEndedError("its answer makes no sense") from error
    data = message[FRAME_HEADER.size :]
    if kind != av_messages.FRAME:
        raise SourceDownError(f"{what} cannot be read: {printable(data.decode(), 100)}")
    return CameraFrame(data, timestamp_s, arrived_s, is_stamped)


async def run_rosbridge(
    graph: RosGraph, topic: str, kind: str, fps: float, on_frame: OnFrame
) -> NoReturn:
    """Give the frames of a topic of compressed images, or of H.264, as they are."""
    is_video = kind in VIDEO_TYPES
    frame_of = _video_frame if is_video else _image_frame
    clock = FrameClock(MAX_LAG_S) if is_video else FrameClock()
    try:
        async with connected(graph.url, max_message_bytes=MAX_IMAGE_MESSAGE_BYTES) as rosbridge:
            await rosbridge.subscribe(topic, kind, **_how(kind, fps))
            while True:
                # A topic slower than one frame in STALL_S is requested again, and that is all.
                message = await within(max(STALL_S, 3 / fps), rosbridge.message())
                frame = frame_of(message, topic, clock)
                if frame is not None:
                    on_frame(frame)
    except asyncio.TimeoutError as error:
        raise SourceDownError(f"rosbridge sent no frame for {STALL_S:g} s") from error
    except (FramesLateError, NotShownError) as error:
        raise SourceDownError(f"{printable(topic, 100)} cannot be shown: {error}") from error
    except (aiohttp.ClientError, OSError) as error:
        raise _rosbridge_down(graph.url, error) from error


def _how(kind: str, fps: float) -> dict[str, int]:
    """Return what is asked of rosbridge: all messages if frames depend on earlier ones, else the newest at a rate."""
    if kind in VIDEO_TYPES:
        return {"throttle_ms": 0, "queue_length": 0}
    return {"throttle_ms": int(1000 * THROTTLE / fps), "queue_length": 1}


async def _image_topic(graph: RosGraph, name: str) -> tuple[str | None, str | None]:
    """Return the topic of a camera's compressed images, and the type of what has the camera's own name."""
    try:
        topics = await graph.topics()
    except (ConnectionError, asyncio.TimeoutError):
        # No rosapi: by what image_transport calls it.
        return (name if name.endswith(COMPRESSED) else f"{name}{COMPRESSED}"), None
    except (aiohttp.ClientError, OSError) as error:
        raise _rosbridge_down(graph.url, error) from error
    return _compressed_of(name, topics), topics.get(name)


def _rosbridge_down(url: str, error: Exception) -> SourceDownError:
    reason = describe_error(error, CONNECT_WITHIN_S)
    return SourceDownError(f"rosbridge at {url} sends no frames: {reason}")


def _full_name(topic: str) -> str:
    return topic if topic.startswith("/") else f"/{topic}"


def _compressed_of(name: str, topics: Mapping[str, str]) -> str | None:
    names = (name, f"{name}{COMPRESSED}")
    return next((each for each in names if topics.get(each) == IMAGE_TYPE), None)


def _no_raw_images(name: str, topics: Mapping[str, str]) -> SourceDownError | None:
    """Return why there are no raw images of a name; nothing where nobody knows the name."""
    compressed, kind = _compressed_of(name, topics), topics.get(name, RAW_IMAGE_TYPE)
    if compressed is not None:
        return NotByServerError(
            f"{printable(compressed, 100)} has only compressed images, which web_video_server "
            "does not show; set video_source to auto in the agent's settings",
            is_raw=False,
        )
    if kind in VIDEO_TYPES:
        return NotByServerError(
            f"{printable(name, 100)} has H.264, which web_video_server does not show; "
            "set video_source to auto in the agent's settings",
            is_raw=False,
        )
    if kind != RAW_IMAGE_TYPE:
        return SourceDownError(
            f"{printable(name, 100)} has messages of {printable(kind, 100)}, which is not video"
        )
    return None


def _image_frame(message: JsonObject, topic: str, clock: FrameClock) -> CameraFrame | None:
    """Return the frame of a message of a compressed image, nothing for an empty one: some drivers begin with it."""
    data = message.get("data")
    if data == "":
        return None
    try:
        jpeg = base64.b64decode(data, validate=True) if isinstance(data, str) else b""
    except (binascii.Error, ValueError):
        jpeg = b""
    if not jpeg.startswith(JPEG_START):
        excerpt = printable(str(message.get("format", "")), 40)
        raise NotJpegError(f"{topic} has images of format {excerpt!r}, not JPEG")
    arrived = now()
    timestamp_s, is_stamped = clock.timestamp(stamp_of(message), arrived, jpeg)
    return CameraFrame(jpeg, timestamp_s, arrived.robot_s, is_stamped)


def _video_frame(message: JsonObject, _topic: str, clock: FrameClock) -> CameraFrame | None:
    """Return the frame of a message of a robot's own H.264, nothing for one without."""
    arrived = now()
    packet = h264_of(message)
    timestamp_s, is_stamped = clock.timestamp(stamp_of(message), arrived, packet)
    if packet is None:
        return None
    data, unit = packet
    return CameraFrame(data, timestamp_s, arrived.robot_s, is_stamped, H264, unit.is_key)

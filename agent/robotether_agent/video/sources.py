"""Opens a camera's source by its name and the settings: one function a kind.

mjpeg      web_video_server's /stream, and any URL that `cameras` names; RTSP and devices by a process of their own
rosbridge  sensor_msgs/CompressedImage, also of a camera that web_video_server cannot show

Each runs until it is cancelled or its source ends, raises SourceDownError in the latter case, and reads on as fast as
frames come: what is not wanted is dropped by whoever takes them, so that nothing waits in between.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import struct
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import NoReturn
from urllib.parse import quote

import aiohttp
from robotether_common.codecs import JPEG, Codec
from robotether_common.frames import MAX_FRAME_BYTES, QOS, Source, no_frames
from yarl import URL

from robotether_agent.clock import robot_time
from robotether_agent.describe_error import describe_error
from robotether_agent.fields import JsonObject, printable
from robotether_agent.problems import DetailError
from robotether_agent.rosbridge import (
    COMPRESSED,
    IMAGE_TYPE,
    RAW_IMAGE_TYPE,
    RosGraph,
    camera_topics,
    compressed_images,
    connected,
)
from robotether_agent.tasks import first_of, within
from robotether_agent.video import av_messages
from robotether_agent.video.av_messages import FRAME_HEADER
from robotether_agent.video.av_process import ProcessEndedError, av_process
from robotether_agent.video.jpeg import JPEG_START
from robotether_agent.video.multipart import (
    MultipartBrokenError,
    MultipartParser,
    Part,
    boundary_of,
)

# Maximum age of a frame's timestamp; an older one is of another clock than this robot's.
NEAR_S = 10.0
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
# Maximum size of a message: a frame in base64, and its envelope.
MAX_MESSAGE_BYTES = MAX_FRAME_BYTES // 3 * 4 + 64 * 1024
# Part of the interval between frames that rosbridge waits; all of it would drop every second frame
# of a camera at the requested rate.
THROTTLE = 0.75
# Time limit for the first frame of an RTSP or V4L2 camera: its process starts, connects, and waits for a key frame.
CAMERA_START_S = 25.0
CAMERA_COMMAND = (sys.executable, "-m", "robotether_agent.video.camera_process")


@dataclass(frozen=True)
class CameraFrame:
    """One frame; both times are on the robot's clock (CLOCK_BOOTTIME), the first is what the frame shows."""

    data: bytes
    timestamp_s: float
    arrived_s: float
    is_stamped: bool = False
    codec: Codec = JPEG


@dataclass(frozen=True)
class SourceRequest:
    """What is asked of a source; equal ones share one. A quality of 0 and no size leave it to the camera."""

    topic: str
    quality: int
    width: int | None
    height: int | None
    # Frames a second, for sources that can be asked to give no more.
    fps: float


class SourceDownError(DetailError):
    """A source gives no frames; the message says why."""

    def __init__(self, message: str, *, answers: bool = True) -> None:
        super().__init__(message)
        # False: nothing listens where the source should be, so that another kind may be tried.
        self.answers = answers


class OnlyCompressedError(SourceDownError):
    """A camera has compressed images alone: web_video_server makes its frames of raw ones."""


OnFrame = Callable[[CameraFrame], None]
OnKind = Callable[[Source], None]


@dataclass(frozen=True)
class ClockReadings:
    """One time on three clocks: since the robot's start, in Unix time, and CLOCK_MONOTONIC."""

    robot_s: float
    wall_s: float
    steady_s: float


def now() -> ClockReadings:
    """Look at the three clocks."""
    return ClockReadings(robot_time(), time.time(), time.clock_gettime(time.CLOCK_MONOTONIC))


def timestamp_of(stamp_s: float | None, arrived: ClockReadings) -> tuple[float, bool]:
    """Return when the frame was taken on the robot's clock, and whether that is the camera's own stamp."""
    if stamp_s is None:
        return arrived.robot_s, False
    for clock_s, is_stamped in ((arrived.wall_s, True), (arrived.steady_s, False)):
        age_s = clock_s - stamp_s
        if 0 <= age_s <= NEAR_S:
            return arrived.robot_s - age_s, is_stamped
    return arrived.robot_s, False


@dataclass(frozen=True)
class SourceSettings:
    """Where the robot's frames are, of the settings: `source` is auto, web_video_server or rosbridge."""

    video_url: str
    rosbridge_url: str
    source: str = "auto"
    # URLs by name; they may contain a login.
    cameras: Mapping[str, str] = field(default_factory=dict, repr=False)


class Sources:
    """Opens the source of any camera."""

    def __init__(
        self, http: aiohttp.ClientSession, source_settings: SourceSettings, graph: RosGraph
    ) -> None:
        self._http = http
        self._source_settings = source_settings
        self._graph = graph
        # What web_video_server could not show: cameras that have compressed images alone, and encodings by camera.
        self._compressed: set[str] = set()
        self._encodings: dict[str, str] = {}

    async def first_camera(self) -> str | None:
        """Return the robot's first camera, or nothing where it has none; SourceDownError where nobody knows."""
        try:
            own = await self._graph.own_topics()
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            raise SourceDownError("rosapi does not say which cameras there are") from error
        if self._source_settings.source == "rosbridge":
            own = compressed_images(own)
        return next(iter(camera_topics(own)), None)

    def steps_quality(self, topic: str) -> bool:
        """Whether quality and size of a camera can be asked for, as far as is known before it is opened."""
        return (
            topic not in self._source_settings.cameras
            and self._source_settings.source != "rosbridge"
        )

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
        self, source_request: SourceRequest, on_frame: OnFrame, on_kind: OnKind
    ) -> None:
        on_kind("rosbridge")
        await run_rosbridge(self._graph, source_request, on_frame)

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
                return SourceDownError(
                    f"web_video_server shows no images of {printable(name, 100)}, "
                    f"which have the encoding {await self._encoding_of(name)}"
                )
        return None

    async def _encoding_of(self, name: str) -> str:
        # Asked once: each raw image is much work for rosbridge, which also carries what drives the robot.
        if name not in self._encodings:
            async with connected(self._graph.url, max_message_bytes=MAX_MESSAGE_BYTES) as rosbridge:
                await rosbridge.subscribe(name, RAW_IMAGE_TYPE, throttle_ms=1000)
                message = await within(CONNECT_WITHIN_S, rosbridge.message())
            self._encodings[name] = printable(str(message.get("encoding", "")), 40)
        return self._encodings[name]

    async def _run_either(
        self, source_request: SourceRequest, on_frame: OnFrame, on_kind: OnKind
    ) -> None:
        if source_request.topic in self._compressed:
            await self._run_compressed(source_request, on_frame, on_kind)
        on_kind("web_video_server")
        try:
            await self._run_server(source_request, on_frame)
        except OnlyCompressedError:
            await self._run_compressed(source_request, on_frame, on_kind)
        except SourceDownError as down:
            if down.answers:
                raise
            await self._run_instead(source_request, on_frame, on_kind, down)

    async def _run_compressed(
        self, source_request: SourceRequest, on_frame: OnFrame, on_kind: OnKind
    ) -> None:
        """Use rosbridge for a camera that has no raw images, and from now on at once."""
        self._compressed.add(source_request.topic)
        try:
            await self._run_rosbridge(source_request, on_frame, on_kind)
        except SourceDownError:
            self._compressed.discard(source_request.topic)
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
            async for data in answer.content.iter_any():
                for part in parts.feed(data):
                    _pass_part(part, on_frame)
    except (aiohttp.ClientConnectorError, aiohttp.ConnectionTimeoutError) as error:
        reason = describe_error(error, CONNECT_WITHIN_S)
        raise SourceDownError(f"{what} does not answer: {reason}", answers=False) from error
    except aiohttp.ServerTimeoutError as error:
        raise SourceDownError(end or f"{what} sent no frame for {stall_s:g} s") from error
    except MultipartBrokenError as error:
        raise SourceDownError(f"{what} cannot be shown: {error}") from error
    except (aiohttp.ClientError, OSError, ValueError, asyncio.TimeoutError) as error:
        raise SourceDownError(f"{what} ended: {describe_error(error, stall_s)}") from error
    raise SourceDownError(end or f"{what} ended the stream")


def _pass_part(part: Part, on_frame: OnFrame) -> None:
    if not part.body.startswith(JPEG_START):
        kind = part.headers.get("content-type", "")
        if kind.startswith("image/") and not kind.startswith("image/jp"):
            raise MultipartBrokenError(f"it sends {printable(kind, 40)}, not JPEG")
        return
    arrived = now()
    stamp: float | None = None
    with suppress(ValueError):
        stamp = float(part.headers["x-timestamp"]) if "x-timestamp" in part.headers else None
    timestamp_s, is_stamped = timestamp_of(stamp, arrived)
    on_frame(CameraFrame(part.body, timestamp_s, arrived.robot_s, is_stamped))


async def run_camera(
    url: str, on_frame: OnFrame, *, what: str, command: Sequence[str] = CAMERA_COMMAND
) -> NoReturn:
    """Give the frames of an RTSP or V4L2 camera, as JPEGs that a process of its own makes."""
    if find_spec("av") is None:
        raise SourceDownError(f"{what} needs PyAV: install robotether-agent[video]")
    try:
        async with av_process(command) as process:
            # Not as an argument, which everybody on the robot may read.
            await process.send(f"{url}\n".encode())
            limit_s = CAMERA_START_S
            while True:
                message = await within(limit_s, process.message(av_messages.MAX_MESSAGE_BYTES))
                on_frame(_camera_frame(message, what))
                limit_s = STALL_S
    except asyncio.TimeoutError as error:
        raise SourceDownError(f"{what} sent no frame for {limit_s:g} s") from error
    except (ProcessEndedError, OSError) as error:
        raise SourceDownError(f"{what} cannot be read: {error}") from error


def _camera_frame(message: bytes, what: str) -> CameraFrame:
    try:
        kind, arrived_s = FRAME_HEADER.unpack_from(message)
    except struct.error as error:
        raise ProcessEndedError("its answer makes no sense") from error
    data = message[FRAME_HEADER.size :]
    if kind != av_messages.FRAME:
        raise SourceDownError(f"{what} cannot be read: {printable(data.decode(), 100)}")
    return CameraFrame(data, arrived_s, arrived_s)


async def run_rosbridge(
    graph: RosGraph, source_request: SourceRequest, on_frame: OnFrame
) -> NoReturn:
    """Give the frames of a CompressedImage topic."""
    try:
        topic = await _image_topic(graph, source_request.topic)
        async with connected(graph.url, max_message_bytes=MAX_MESSAGE_BYTES) as rosbridge:
            throttle_ms = int(1000 * THROTTLE / source_request.fps)
            await rosbridge.subscribe(topic, IMAGE_TYPE, throttle_ms=throttle_ms)
            while True:
                # A topic slower than one frame in STALL_S is requested again, and that is all.
                message = await within(max(STALL_S, 3 / source_request.fps), rosbridge.message())
                on_frame(_frame_of(message, topic))
    except asyncio.TimeoutError as error:
        raise SourceDownError(f"rosbridge sent no frame for {STALL_S:g} s") from error
    except (aiohttp.ClientError, OSError) as error:
        reason = describe_error(error, CONNECT_WITHIN_S)
        raise SourceDownError(f"rosbridge at {graph.url} sends no frames: {reason}") from error


async def _image_topic(graph: RosGraph, camera: str) -> str:
    """Return the name under which rosbridge has a camera's compressed frames."""
    name = _full_name(camera)
    try:
        topic = _compressed_of(name, await graph.topics())
    except (ConnectionError, asyncio.TimeoutError):
        # No rosapi: by what image_transport calls it.
        return name if name.endswith(COMPRESSED) else f"{name}{COMPRESSED}"
    if topic is None:
        raise SourceDownError(f"rosbridge has no compressed images of {printable(name, 100)}")
    return topic


def _full_name(topic: str) -> str:
    return topic if topic.startswith("/") else f"/{topic}"


def _compressed_of(name: str, topics: Mapping[str, str]) -> str | None:
    names = (name, f"{name}{COMPRESSED}")
    return next((each for each in names if topics.get(each) == IMAGE_TYPE), None)


def _no_raw_images(name: str, topics: Mapping[str, str]) -> SourceDownError | None:
    """Return why there are no raw images of a name; nothing where nobody knows the name."""
    compressed, kind = _compressed_of(name, topics), topics.get(name, RAW_IMAGE_TYPE)
    if compressed is not None:
        return OnlyCompressedError(
            f"{printable(compressed, 100)} has compressed images alone, which web_video_server "
            "does not show; set video_source to auto in the agent's settings"
        )
    if kind != RAW_IMAGE_TYPE:
        return SourceDownError(
            f"{printable(name, 100)} has messages of {printable(kind, 100)}, which is no video"
        )
    return None


def _frame_of(message: JsonObject, topic: str) -> CameraFrame:
    data = message.get("data")
    try:
        jpeg = base64.b64decode(data, validate=True) if isinstance(data, str) else b""
    except (binascii.Error, ValueError):
        jpeg = b""
    if not jpeg.startswith(JPEG_START):
        excerpt = printable(str(message.get("format", "")), 40)
        raise SourceDownError(f"{topic} has images of format {excerpt!r}, not JPEG")
    arrived = now()
    timestamp_s, is_stamped = timestamp_of(stamp_of(message), arrived)
    return CameraFrame(jpeg, timestamp_s, arrived.robot_s, is_stamped)


def stamp_of(message: JsonObject) -> float | None:
    """Return a header's stamp in seconds, as ROS 1 (secs, nsecs) and ROS 2 (sec, nanosec) write it; 0 is none."""
    header = message.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    if not isinstance(stamp, dict):
        return None
    for whole, part in (("sec", "nanosec"), ("secs", "nsecs")):
        seconds, nanoseconds = stamp.get(whole), stamp.get(part)
        if isinstance(seconds, int) and isinstance(nanoseconds, int):
            return seconds + nanoseconds / 1e9 or None
    return None

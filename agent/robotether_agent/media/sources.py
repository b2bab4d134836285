"""Where a camera's pictures come from, by its name and the settings: one function a kind.

mjpeg      web_video_server's /stream, and any URL that `cameras` names
rosbridge  sensor_msgs/CompressedImage

Each runs until it is cancelled or its source ends, raises SourceDownError in the latter case, and reads on as fast as
pictures come: what is not wanted is dropped by whoever takes them, so that nothing waits in between.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NoReturn
from urllib.parse import quote

import aiohttp
from yarl import URL

from robotether_agent.fields import JsonObject, printable
from robotether_agent.media.moments import moment, now
from robotether_agent.media.multipart import Part, Parts, PartsBrokenError, boundary_of
from robotether_agent.media.picture import (
    JPEG_START,
    PICTURE_BYTES_MAX,
    Kind,
    Picture,
    SourceDownError,
    Wish,
)
from robotether_agent.reasons import why
from robotether_agent.rosbridge import IMAGE_TYPE, Rosbridge, connected
from robotether_agent.tasks import first_of, within

CONNECT_WITHIN_S = 3.0
# Without a picture for so long a source is opened anew.
STALL_S = 10.0
# Where both kinds may be, so often is looked whether web_video_server has come back.
LOOK_AGAIN_S = 10.0
COMPRESSED = "/compressed"
# As base64, and what stands around it.
MESSAGE_BYTES_MAX = PICTURE_BYTES_MAX // 3 * 4 + 64 * 1024
# rosbridge sends nothing sooner than this part of the time between two pictures; all of it would drop every second one
# of a camera that has just the wanted rate.
THROTTLE = 0.75

Take = Callable[[Picture], None]
Tell = Callable[[Kind], None]


@dataclass(frozen=True)
class Places:
    """Where the robot's pictures are, of the settings: `source` is auto, web_video_server or rosbridge."""

    video_url: str
    rosbridge_url: str
    source: str = "auto"
    # URLs by name; a login may stand in them.
    cameras: Mapping[str, str] = field(default_factory=dict, repr=False)


class Sources:
    """Opens the source of any camera."""

    def __init__(self, http: aiohttp.ClientSession, places: Places) -> None:
        self._http = http
        self._places = places

    def steps_quality(self, topic: str) -> bool:
        """Whether quality and size of a camera can be asked for, as far as is known before it is opened."""
        return topic not in self._places.cameras and self._places.source != "rosbridge"

    async def run(self, wish: Wish, take: Take, tell: Tell) -> NoReturn:
        """Give pictures, after telling of which kind the source is; SourceDownError when there are no more."""
        url = self._places.cameras.get(wish.topic)
        if url is not None:
            tell("mjpeg")
            await run_mjpeg(self._http, url, take, f"camera {wish.topic}")
        elif self._places.source == "rosbridge":
            tell("rosbridge")
            await run_rosbridge(self._places.rosbridge_url, wish, take)
        elif self._places.source == "web_video_server":
            tell("web_video_server")
            await self._run_server(wish, take)
        else:
            await self._run_either(wish, take, tell)
        raise SourceDownError("it ended")

    async def _run_server(self, wish: Wish, take: Take) -> None:
        what = f"web_video_server at {self._places.video_url}"
        await run_mjpeg(self._http, stream_url(self._places.video_url, wish), take, what)

    async def _run_either(self, wish: Wish, take: Take, tell: Tell) -> None:
        """Use rosbridge while nothing answers where web_video_server should be."""
        tell("web_video_server")
        try:
            await self._run_server(wish, take)
        except SourceDownError as down:
            if down.answers:
                raise
            first = down
        tell("rosbridge")
        try:
            await first_of(
                run_rosbridge(self._places.rosbridge_url, wish, take),
                self._until_server_answers(),
            )
        except SourceDownError as down:
            tell("web_video_server")
            raise SourceDownError(f"{first}; {down}") from down
        raise SourceDownError("web_video_server answers again")

    async def _until_server_answers(self) -> None:
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            with suppress(aiohttp.ClientError, OSError, asyncio.TimeoutError):
                timeout = aiohttp.ClientTimeout(total=CONNECT_WITHIN_S)
                async with self._http.get(self._places.video_url, timeout=timeout):
                    return


def stream_url(video_url: str, wish: Wish) -> str:
    """Return the URL of web_video_server's stream."""
    size = "" if wish.width is None else f"&width={wish.width}&height={wish.height}"
    return f"{video_url}/stream?topic={quote(wish.topic)}&type=mjpeg&quality={wish.quality}{size}"


async def run_mjpeg(http: aiohttp.ClientSession, url: str, take: Take, what: str) -> NoReturn:
    """Give the pictures of a multipart stream; `what` names it in errors."""
    timeout = aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_WITHIN_S, sock_read=STALL_S)
    try:
        # Encoded already; a camera's own signs stay as they are.
        async with http.get(URL(url, encoded=True), timeout=timeout) as answer:
            if answer.status != 200:  # noqa: PLR2004
                raise SourceDownError(f"{what} answers with HTTP status {answer.status}")
            parts = Parts(boundary_of(answer.headers.get("Content-Type", "")))
            async for data in answer.content.iter_any():
                for part in parts.feed(data):
                    _take_part(part, take)
    except (aiohttp.ClientConnectorError, aiohttp.ConnectionTimeoutError) as error:
        reason = why(error, CONNECT_WITHIN_S)
        raise SourceDownError(f"{what} does not answer: {reason}", answers=False) from error
    except aiohttp.ServerTimeoutError as error:
        raise SourceDownError(f"{what} gave no picture for {STALL_S:g} s") from error
    except PartsBrokenError as error:
        raise SourceDownError(f"{what} cannot be shown: {error}") from error
    except (aiohttp.ClientError, OSError, ValueError, asyncio.TimeoutError) as error:
        raise SourceDownError(f"{what} ended: {why(error, STALL_S)}") from error
    raise SourceDownError(f"{what} ended the stream; is there such a camera?")


def _take_part(part: Part, take: Take) -> None:
    if not part.body.startswith(JPEG_START):
        return
    arrived = now()
    stamp: float | None = None
    with suppress(ValueError):
        stamp = float(part.headers["x-timestamp"]) if "x-timestamp" in part.headers else None
    moment_s, is_stamped = moment(stamp, arrived)
    take(Picture(part.body, moment_s, arrived.robot_s, is_stamped))


async def run_rosbridge(url: str, wish: Wish, take: Take) -> NoReturn:
    """Give the pictures of a CompressedImage topic."""
    try:
        async with connected(url, message_bytes_max=MESSAGE_BYTES_MAX) as rosbridge:
            topic = await _image_topic(rosbridge, wish.topic)
            throttle_ms = int(1000 * THROTTLE / wish.fps)
            await rosbridge.subscribe(topic, IMAGE_TYPE, throttle_ms=throttle_ms)
            while True:
                # A topic slower than one picture in STALL_S is asked for anew, and that is all.
                message = await within(max(STALL_S, 3 / wish.fps), rosbridge.message())
                take(_picture_of(message, topic))
    except asyncio.TimeoutError as error:
        raise SourceDownError(f"rosbridge gave no picture for {STALL_S:g} s") from error
    except (aiohttp.ClientError, OSError) as error:
        reason = why(error, CONNECT_WITHIN_S)
        raise SourceDownError(f"rosbridge at {url} gives no pictures: {reason}") from error


async def _image_topic(rosbridge: Rosbridge, wanted: str) -> str:
    """Return the name under which rosbridge has a camera's compressed pictures."""
    name = wanted if wanted.startswith("/") else f"/{wanted}"
    names = (name, f"{name}{COMPRESSED}")
    try:
        topics = await rosbridge.topics()
    except asyncio.TimeoutError:
        # No rosapi: by what image_transport calls it.
        return name if name.endswith(COMPRESSED) else names[1]
    for found in names:
        if topics.get(found) == IMAGE_TYPE:
            return found
    raise SourceDownError(f"rosbridge has no compressed pictures of {printable(name, 100)}")


def _picture_of(message: JsonObject, topic: str) -> Picture:
    data = message.get("data")
    try:
        jpeg = base64.b64decode(data, validate=True) if isinstance(data, str) else b""
    except (binascii.Error, ValueError):
        jpeg = b""
    if not jpeg.startswith(JPEG_START):
        shown = printable(str(message.get("format", "")), 40)
        raise SourceDownError(f"{topic} has pictures of format {shown!r}, not JPEG")
    arrived = now()
    moment_s, is_stamped = moment(stamp_of(message), arrived)
    return Picture(jpeg, moment_s, arrived.robot_s, is_stamped)


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

"""The simulated robot's port 8080: the cameras under web_video_server's URLs.

Started by simulator.py. Each viewer gets the newest frame when it has taken the last one, so a slow one
skips frames and nothing queues. A topic without frames is as silent here as there: one that does not exist ends the
stream within half a second, and one that is not heard, by its QoS, keeps it without a word.
"""

import asyncio
import logging
import socket
from collections.abc import Container, Mapping

from aiohttp import web

from sim_robot.camera import FrameFeed, FrameFormat, RenderedFrame

log = logging.getLogger(__name__)

BOUNDARY = "boundarydonotcross"
SIZE_LIMIT_PX = 2048
UNSENT_LIMIT_BYTES = 16_384
# Interval at which the real one ends the streams of topics that do not exist.
CLEANUP_S = 0.5
SENSOR_DATA = "sensor_data"
_HEADERS = {
    "Connection": "close",
    "Server": "web_video_server",
    "Cache-Control": "no-cache, no-store, must-revalidate, pre-check=0, post-check=0, max-age=0",
    "Pragma": "no-cache",
    "Access-Control-Allow-Origin": "*",
}


class VideoServer:
    """The HTTP server of one robot's cameras; `feeds` has each under its topic.

    Those in `best_effort` publish as ROS 2's sensors do: the default QoS, which is reliable, hears nothing of them.
    """

    def __init__(self, feeds: Mapping[str, FrameFeed], best_effort: Container[str] = ()) -> None:
        self._feeds = feeds
        self._best_effort = best_effort
        self.app = app = web.Application()
        app.router.add_get("/", self._list)
        app.router.add_get("/stream", self._stream, allow_head=False)
        app.router.add_get("/snapshot", self._snapshot, allow_head=False)

    async def _list(self, _request: web.Request) -> web.Response:
        body = "".join(map(_links, self._feeds))
        return _page("ROS Image Topic List", f"<h1>Available ROS Image Topics:</h1><ul>{body}</ul>")

    async def _snapshot(self, request: web.Request) -> web.StreamResponse:
        query = _query_of(request)
        feed = self._feed(query)
        frame_format = _frame_format(feed, query)
        if feed is None:
            await asyncio.sleep(CLEANUP_S)
            return _cut_off(request)
        if not self._hears(query):
            await _stay_silent(request)
            return _cut_off(request)
        frame = await feed.next_frame(frame_format)
        headers = _HEADERS | {"X-Timestamp": _timestamp(frame)}
        return web.Response(body=frame.jpeg, content_type="image/jpeg", headers=headers)

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        query = _query_of(request)
        _check_type(query)
        feed = self._feed(query)
        frame_format = _frame_format(feed, query)
        content_type = f"multipart/x-mixed-replace;boundary={BOUNDARY}"
        response = web.StreamResponse(headers=_HEADERS | {"Content-Type": content_type})
        response.force_close()
        _keep_little_unsent(request)
        await response.prepare(request)
        try:
            await response.write(f"--{BOUNDARY}\r\n".encode())
            if feed is None:
                await asyncio.sleep(CLEANUP_S)
            elif self._hears(query):
                await _send_frames(response, feed, frame_format)
            else:
                await _stay_silent(request)
        except ConnectionError:
            log.debug("a viewer from %s left", request.remote)
        return response

    def _feed(self, query: Mapping[str, str]) -> FrameFeed | None:
        return self._feeds.get(_topic(query))

    def _hears(self, query: Mapping[str, str]) -> bool:
        return _topic(query) not in self._best_effort or query.get("qos_profile") == SENSOR_DATA


def _topic(query: Mapping[str, str]) -> str:
    return "/" + query.get("topic", "").removeprefix("/")


def _query_of(request: web.Request) -> dict[str, str]:
    """Return the query as async_web_server_cpp reads it: no escapes undone, of two words of a name the last."""
    words = (word.partition("=") for word in request.rel_url.raw_query_string.split("&"))
    return {name: value for name, _, value in words if name}


async def _send_frames(
    response: web.StreamResponse, feed: FrameFeed, frame_format: FrameFormat
) -> None:
    sequence = -1
    while True:
        frame = await feed.next_frame(frame_format, after=sequence)
        sequence = frame.sequence
        await response.write(_part(frame))


def _links(name: str) -> str:
    return (
        f'<li>{name} (<a href="/stream?topic={name}">Stream</a>)'
        f' (<a href="/snapshot?topic={name}">Snapshot</a>)</li>'
    )


def _part(frame: RenderedFrame) -> bytes:
    head = (
        "Content-type: image/jpeg\r\n"
        f"X-Timestamp: {_timestamp(frame)}\r\n"
        f"Content-Length: {len(frame.jpeg)}\r\n\r\n"
    )
    return head.encode() + frame.jpeg + f"\r\n--{BOUNDARY}\r\n".encode()


def _timestamp(frame: RenderedFrame) -> str:
    return f"{frame.stamp_ns // 1000 / 1e6:.6f}"


def _page(title: str, body: str) -> web.Response:
    text = f"<html><head><title>{title}</title></head><body>{body}</body></html>"
    return web.Response(text=text, content_type="text/html", headers=_HEADERS)


def _check_type(query: Mapping[str, str]) -> None:
    # ros_compressed falls back to mjpeg where there is no compressed topic, as the real one does.
    if query.get("type", "mjpeg") not in ("mjpeg", "ros_compressed"):
        raise web.HTTPNotFound(text="Not Found")


def _frame_format(feed: FrameFeed | None, query: Mapping[str, str]) -> FrameFormat:
    own = FrameFormat() if feed is None else feed.own_format
    return FrameFormat(
        width=_number(query, "width", own.width, SIZE_LIMIT_PX),
        height=_number(query, "height", own.height, SIZE_LIMIT_PX),
        quality=_number(query, "quality", own.quality, 100),
    )


def _number(query: Mapping[str, str], name: str, default: int, high: int) -> int:
    text = query.get(name, str(default))
    if not (text.isascii() and text.isdecimal()) or not 1 <= int(text[:9]) <= high:
        why = f"{name} is {text!r:.40}, allowed is a whole number from 1 to {high}"
        raise web.HTTPBadRequest(text=f"cannot show the camera: {why}")
    return int(text)


async def _stay_silent(request: web.Request) -> None:
    """Wait until the viewer has left."""
    while request.transport is not None and not request.transport.is_closing():  # noqa: ASYNC110  no event tells
        await asyncio.sleep(CLEANUP_S)


def _cut_off(request: web.Request) -> web.Response:
    """End the connection without an answer, as the real one does for a snapshot of no topic."""
    if request.transport is not None:
        request.transport.abort()
    return web.Response(status=404)


def _keep_little_unsent(request: web.Request) -> None:
    """Let the kernel and the transport hold little, so that what a viewer gets is new."""
    transport = request.transport
    if transport is None:
        return
    transport.set_write_buffer_limits(high=0)
    connection = transport.get_extra_info("socket")
    if connection is not None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_LIMIT_BYTES)

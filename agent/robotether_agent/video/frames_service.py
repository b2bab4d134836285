"""The media service: frames by credit at /robotether/frames, and web_video_server's URLs where there is none.

`routes` are the agent's own paths besides.

Started by the agent beside the video proxy, which leads here what is its own; listens on 127.0.0.1 alone, as the
robot's own services do. Each answer ends its connection, so that the next request on it cannot miss the other service.

    service = FramesService(places, graph)
    port = await service.start()
    await service.close()
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import AsyncExitStack, closing, contextmanager, suppress
from dataclasses import replace

import aiohttp
from aiohttp import web
from robotether_common.frames import MAX_TEXT_BYTES, PATH, StreamRequest
from robotether_common.guard import REASON_HEADER

from robotether_agent.fields import FieldError
from robotether_agent.rosbridge import RosGraph
from robotether_agent.rosbridge_socket import close_reason
from robotether_agent.tasks import within
from robotether_agent.unsent import SEND_BYTES, keep_little_unsent
from robotether_agent.video.encoding import encoded_size
from robotether_agent.video.frame_encoder import EncoderPool
from robotether_agent.video.receiver import OnFrameSent, Receiver
from robotether_agent.video.shared_sources import MAX_SHARED_SOURCES, SharedSources
from robotether_agent.video.sources import (
    CameraFrame,
    SourceDownError,
    SourceRequest,
    Sources,
    SourceSettings,
    camera_http,
)

ADDRESS = "127.0.0.1"
MAX_TOPIC_LENGTH = 256
# Maximum number of receivers; the relay has one per camera, and briefly two when it reconnects.
MAX_RECEIVERS = 2 * MAX_SHARED_SOURCES
SHUTDOWN_S = 0.2
FAREWELL_S = 0.5
# Time limits for a still, and for a look at the camera's own size before it.
STILL_WITHIN_S, SIZE_WITHIN_S = 5.0, 2.0
BOUNDARY = "robotether"

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

log = logging.getLogger(__name__)


class FramesService:
    """All receivers of this robot's frames."""

    def __init__(
        self,
        source_settings: SourceSettings,
        graph: RosGraph,
        *,
        video_encoder: str = "off",
        has_video: Callable[[], bool] = lambda: True,
        routes: Mapping[str, Handler] | None = None,
        on_frame_sent: OnFrameSent = lambda *_: None,
        on_encoders: Callable[[str], None] = lambda _: None,
        line_rate: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._routes = routes or {}
        self._source_settings = source_settings
        self._graph = graph
        self._has_video = has_video
        self._on_frame_sent = on_frame_sent
        self._encoders = EncoderPool(video_encoder, on_change=on_encoders, line_rate=line_rate)
        self._topics: Counter[str] = Counter()
        # By the port at the other end of their connection.
        self._receivers: dict[int, Receiver] = {}

    async def start(self) -> int:
        """Listen, and return the port, which the kernel chooses."""
        self._http = camera_http()
        self._sources = Sources(self._http, self._source_settings, self._graph)
        self._shared_sources = SharedSources(self._sources.run, answered=self._sources.answered)
        app = web.Application(middlewares=[_one_answer])
        app.router.add_get(PATH, self._frames)
        for path, handler in self._routes.items():
            app.router.add_get(path, handler, allow_head=False)
        app.router.add_get("/snapshot", self._snapshot, allow_head=False)
        app.router.add_get("/robotether/snapshot", self._snapshot_of_any, allow_head=False)
        app.router.add_get("/stream", self._stream, allow_head=False)
        app.router.add_get("/", self._list)
        # Cancellation ends an answer whose asker is gone also while it waits for a frame.
        self._runner = web.AppRunner(
            app, access_log=None, handler_cancellation=True, shutdown_timeout=SHUTDOWN_S
        )
        await self._runner.setup()
        await web.TCPSite(self._runner, ADDRESS, 0).start()
        port: int = self._runner.addresses[0][1]
        return port

    async def close(self) -> None:
        """End all answers and sources, also when this is cancelled."""
        async with AsyncExitStack() as ends:
            ends.push_async_callback(self._http.close)
            ends.push_async_callback(self._shared_sources.close)
            ends.push_async_callback(self._runner.cleanup)

    async def _frames(self, request: web.Request) -> web.StreamResponse:
        topic = _topic(request)
        answer = web.WebSocketResponse(
            timeout=FAREWELL_S, compress=False, max_msg_size=MAX_TEXT_BYTES, writer_limit=SEND_BYTES
        )
        if not answer.can_prepare(request):
            raise web.HTTPNotFound(text="connect with a WebSocket\n")
        with self._counted(topic):
            keep_little_unsent(request)
            await answer.prepare(request)
            await self._serve(answer, topic, int(request.get_extra_info("peername")[1]))
        return answer

    def yields(self, port: int) -> bool:
        """Whether what else the robot sends goes before what is sent to this port of this computer."""
        receiver = self._receivers.get(port)
        return receiver is not None and receiver.yields

    async def _serve(self, answer: web.WebSocketResponse, topic: str, port: int) -> None:
        receiver = Receiver(
            answer,
            topic,
            self._shared_sources,
            steps_quality=lambda: self._sources.steps_quality(topic),
            encoders=self._encoders,
            on_frame_sent=self._on_frame_sent,
        )
        self._receivers[port] = receiver
        try:
            await receiver.run()
        except FieldError as error:
            log.warning("ended a receiver of %s: %s", topic, error)
            await answer.close(
                code=aiohttp.WSCloseCode.PROTOCOL_ERROR, message=close_reason(str(error))
            )
        except ConnectionError as error:
            log.debug("a receiver of %s left: %r", topic, error)
        finally:
            del self._receivers[port]

    @contextmanager
    def _counted(self, topic: str) -> Iterator[None]:
        """Count a receiver while it is served; refuse it where there are too many."""
        is_new = topic not in self._topics
        if self._topics.total() >= MAX_RECEIVERS or (
            is_new and len(self._topics) >= MAX_SHARED_SOURCES
        ):
            why = f"{len(self._topics)} cameras are open"
            raise web.HTTPServiceUnavailable(text=f"{why}\n", headers={REASON_HEADER: why})
        self._topics[topic] += 1
        try:
            yield
        finally:
            self._topics[topic] -= 1
            if not self._topics[topic]:
                del self._topics[topic]

    async def _list(self, request: web.Request) -> web.Response:
        """Answer whoever looks whether video works; without any as if nothing listened, which the server asks for."""
        if not self._has_video() and request.transport is not None:
            request.transport.abort()
        return web.Response(text="the agent's own video: /stream?topic=, /snapshot?topic=\n")

    async def _snapshot_of_any(self, request: web.Request) -> web.StreamResponse:
        """Answer with a still of the camera that is named, or else of the robot's first."""
        if "topic" in request.query:
            return await self._snapshot(request)
        try:
            topic = await self._sources.first_camera()
        except SourceDownError as down:
            raise web.HTTPServiceUnavailable(text=f"{down}\n") from down
        if topic is None:
            raise web.HTTPNotFound(text="this robot has no camera\n")
        return await self._first_frame(_source_request(request, topic))

    async def _snapshot(self, request: web.Request) -> web.StreamResponse:
        return await self._first_frame(_source_request(request, _topic(request)))

    async def _first_frame(self, source_request: SourceRequest) -> web.StreamResponse:
        source_request = await self._shaped(source_request)
        with closing(_Newest(self._shared_sources, source_request)) as newest:
            frame = await newest.first()
        return web.Response(body=frame.data, content_type=frame.codec.mime_type)

    async def _shaped(self, source_request: SourceRequest) -> SourceRequest:
        """Request the camera's shape of web_video_server, which makes the requested size of any."""
        width, height = source_request.width, source_request.height
        if width is None or height is None or not self._sources.steps_quality(source_request.topic):
            return source_request
        own = await self._shared_sources.own_size(source_request, SIZE_WITHIN_S)
        if own is not None:
            width, height = encoded_size(own, (width, height), 1.0)
        return replace(source_request, width=width, height=height)

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        source_request = _source_request(request, _topic(request))
        with (
            self._counted(source_request.topic),
            closing(_Newest(self._shared_sources, source_request)) as newest,
        ):
            # A camera that gives nothing is an error, which a stream that has begun cannot report.
            first = await newest.first()
            return await _pour(request, first, newest)


class _Newest:
    """The newest frame of a request, for answers that have no credit."""

    def __init__(self, shared_sources: SharedSources, source_request: SourceRequest) -> None:
        self._shared_sources = shared_sources
        self._frame: CameraFrame | None = None
        self._has_frame = asyncio.Event()
        self._shared = shared_sources.follow(source_request, self, self._on_frame)

    def close(self) -> None:
        """Want no more."""
        self._shared_sources.leave(self._shared, self)

    async def next(self) -> CameraFrame:
        """Return one that was not returned before."""
        while self._frame is None:
            self._has_frame.clear()
            await self._has_frame.wait()
        frame, self._frame = self._frame, None
        return frame

    async def first(self) -> CameraFrame:
        """Return the first one, or answer why there is none."""
        try:
            return await within(STILL_WITHIN_S, self.next())
        except asyncio.TimeoutError as error:
            reason = self._shared.condition().detail or "there is no frame yet"
            raise web.HTTPServiceUnavailable(text=f"{reason}\n") from error

    def _on_frame(self, frame: CameraFrame) -> None:
        self._frame = frame
        self._has_frame.set()


@web.middleware
async def _one_answer(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Let each connection end with its answer."""
    try:
        answer = await handler(request)
    except web.HTTPException as problem:
        problem.headers["Connection"] = "close"
        raise
    if not answer.prepared:
        answer.force_close()
    return answer


def _topic(request: web.Request) -> str:
    topic = request.query.get("topic", "")
    if not 0 < len(topic) <= MAX_TOPIC_LENGTH or not topic.isprintable():
        raise web.HTTPBadRequest(text="name the camera: ?topic=/camera/image_raw\n")
    return topic


def _source_request(request: web.Request, topic: str) -> SourceRequest:
    """Return what a URL of web_video_server's kind asks for; its other words are not known here."""
    query = request.query
    try:
        quality = int(query.get("quality", StreamRequest.quality_max))
        sizes = [int(query[name]) for name in ("width", "height") if name in query]
    except ValueError as error:
        raise web.HTTPBadRequest(text="quality, width and height are whole numbers\n") from error
    width, height = sizes if len(sizes) == 2 else (None, None)  # noqa: PLR2004
    return SourceRequest(topic, max(1, min(quality, 100)), width, height, StreamRequest.fps)


async def _pour(request: web.Request, first: CameraFrame, newest: _Newest) -> web.StreamResponse:
    kind = f"multipart/x-mixed-replace;boundary={BOUNDARY}"
    answer = web.StreamResponse(headers={"Content-Type": kind})
    answer.force_close()
    keep_little_unsent(request)
    await answer.prepare(request)
    with suppress(ConnectionError):
        await answer.write(f"--{BOUNDARY}\r\n".encode() + _part(first))
        while True:
            await answer.write(_part(await newest.next()))
    return answer


def _part(frame: CameraFrame) -> bytes:
    head = f"Content-type: {frame.codec.mime_type}\r\nContent-Length: {len(frame.data)}\r\n\r\n"
    return head.encode() + frame.data + f"\r\n--{BOUNDARY}\r\n".encode()

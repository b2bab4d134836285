"""Doubles of the sources of a robot's video: web_video_server, and rosbridge with topics.

FakeVideoServer's modes: `streams`; `silent` sends headers and no picture; `ends` ends each stream at once; `refuses`
answers 500; `lists` is another type than multipart. Its pictures are a JPEG's headers, with as many bytes as their
quality would have.
"""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections.abc import Callable
from typing import Any, Literal

from aiohttp import WSMsgType, web
from tcp_service import WebService

Mode = Literal["streams", "silent", "ends", "refuses", "lists"]
BYTES_A_QUALITY = 400
TOPICS_SERVICE = "/rosapi/topics"
WAIT_S = 30.0


def fake_jpeg(number: int, *, size: tuple[int, int] = (640, 480), length: int = 2000) -> bytes:
    """What begins like a JPEG of that size: a comment with its number, the start of frame, and filling."""
    comment = b"\xff\xfe" + struct.pack("!HI", 6, number)
    frame = b"\xff\xc0" + struct.pack("!HBHHB", 8, 8, size[1], size[0], 0)
    return (b"\xff\xd8" + comment + frame).ljust(length - 2, b"\x00") + b"\xff\xd9"


def number_of(jpeg: bytes) -> int:
    number: int = struct.unpack_from("!I", jpeg, 6)[0]
    return number


class FakeVideoServer(WebService):
    handler_cancellation = True

    def __init__(self, mode: Mode = "streams", fps: float = 30.0) -> None:
        super().__init__()
        self.mode = mode
        self.fps = fps
        self.size = (640, 480)
        # The pictures that were made, for all streams together: the same moment has the same number in each.
        self.number = 0
        self.stamp: Callable[[], float] | None = time.time
        self.names_length = True
        self.content_type = "image/jpeg"
        # Sent in place of a JPEG.
        self.picture: bytes | None = None
        # Where it leads whoever asks for a stream; empty: nowhere.
        self.redirects_to = ""
        self.asked: list[dict[str, str]] = []
        self.open = 0
        self.open_most = 0

    async def start(self) -> None:
        await super().start()
        self._clock = asyncio.ensure_future(self._count())

    async def stop(self) -> None:
        self._clock.cancel()
        await asyncio.gather(self._clock, return_exceptions=True)
        await super().stop()

    def _routes(self) -> dict[str, Any]:
        return {"/": self._list, "/stream": self._stream}

    async def _count(self) -> None:
        self._made = asyncio.Condition()
        while True:
            async with self._made:
                self.number += 1
                self._made.notify_all()
            await asyncio.sleep(1 / self.fps)

    async def _list(self, _: web.Request) -> web.Response:
        return web.Response(text="topics", status=500 if self.mode == "refuses" else 200)

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        self.asked.append(dict(request.query))
        if self.redirects_to:
            raise web.HTTPFound(self.redirects_to)
        if self.mode == "refuses":
            return web.Response(status=500)
        kind = "text/html" if self.mode == "lists" else "multipart/x-mixed-replace;boundary=--b"
        answer = web.StreamResponse(headers={"Content-Type": kind})
        answer.force_close()
        await answer.prepare(request)
        self.open += 1
        self.open_most = max(self.open_most, self.open)
        try:
            await answer.write(b"--b\r\n")
            if self.mode == "silent":
                await asyncio.Event().wait()
            if self.mode == "streams":
                await self._send(answer, request.query)
        except ConnectionError:
            pass
        finally:
            self.open -= 1
        return answer

    async def _send(self, answer: web.StreamResponse, query: Any) -> None:
        length = BYTES_A_QUALITY * int(query.get("quality", 95))
        size = self.size
        if "width" in query:
            size = int(query["width"]), int(query["height"])
            length = length * size[0] * size[1] // (self.size[0] * self.size[1])
        while self.mode == "streams":
            async with self._made:
                await self._made.wait()
            head = f"Content-type: {self.content_type}\r\n"
            if self.stamp is not None:
                head += f"X-Timestamp: {self.stamp():.06f}\r\n"
            jpeg = self.picture or fake_jpeg(self.number, size=size, length=length)
            if self.names_length:
                head += f"Content-Length: {len(jpeg)}\r\n"
            await answer.write(head.encode() + b"\r\n" + jpeg + b"\r\n--b\r\n")


class TopicRosbridge(WebService):
    """A rosbridge with `topics` by name and type; None is one without rosapi. Publishes what a test says.

    A connection that has called a rosapi which is not there handles nothing else. `parameters` are of rosbridge itself.
    """

    scheme = "ws"

    def __init__(self, topics: dict[str, str] | None = None, **parameters: bool) -> None:
        super().__init__()
        self.topics = topics
        self.parameters = parameters
        # What rosapi says of who publishes and who subscribes; None: rosbridge finds no such service.
        self.publishers: list[str] | None = None
        self.subscribers: list[str] | None = None
        # The ids with which a call is answered, one answer each.
        self.answer_ids: Callable[[str], list[Any]] = lambda call_id: [call_id]
        self.got: list[dict[str, Any]] = []
        self._sockets: set[web.WebSocketResponse] = set()
        self._stopped = asyncio.Event()

    @property
    def open(self) -> int:
        return len(self._sockets)

    async def start(self) -> None:
        self._stopped.clear()
        await super().start()

    async def stop(self) -> None:
        self._stopped.set()
        for socket in tuple(self._sockets):
            await socket.close()
        await super().stop()

    def _routes(self) -> dict[str, Any]:
        return {"/": self._serve}

    def subscribed(self, topic: str) -> list[dict[str, Any]]:
        return [m for m in self.got if m["op"] == "subscribe" and m["topic"] == topic]

    async def subscription(self, topic: str, number: int = 1) -> dict[str, Any]:
        """Wait for the subscription `number` to a topic, counted from 1."""
        deadline = time.monotonic() + WAIT_S
        while len(self.subscribed(topic)) < number:
            assert time.monotonic() < deadline, f"not {number} subscriptions to {topic}: {self.got}"
            await asyncio.sleep(0.02)
        return self.subscribed(topic)[number - 1]

    async def publish(self, topic: str, message: dict[str, Any]) -> None:
        for socket in tuple(self._sockets):
            await socket.send_json({"op": "publish", "topic": topic, "msg": message})

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(timeout=0.1)
        await socket.prepare(request)
        self._sockets.add(socket)
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    operation = json.loads(message.data)
                    if operation["op"] == "call_service" and self.topics is None:
                        await self._stopped.wait()
                    await self._take(socket, operation)
        finally:
            self._sockets.discard(socket)
        return socket

    async def _take(self, socket: web.WebSocketResponse, operation: dict[str, Any]) -> None:
        self.got.append(operation)
        if operation["op"] == "call_service":
            answer = {"op": "service_response", "result": True}
            answer |= {"service": operation["service"], "values": self._look_up(operation)}
            for answer_id in self.answer_ids(operation["id"]):
                await socket.send_json({**answer, "id": answer_id})

    def _look_up(self, operation: dict[str, Any]) -> dict[str, Any]:
        if operation["service"] == TOPICS_SERVICE:
            assert self.topics is not None
            return {"topics": list(self.topics), "types": list(self.topics.values())}
        kind = operation["service"].rpartition("/")[2]
        if kind in {"publishers", "subscribers"}:
            return {kind: getattr(self, kind)}
        assert operation["service"] == "/rosapi/get_param"
        name = operation["args"]["name"].partition(":")[2]
        return {"value": json.dumps(self.parameters.get(name, ""))}

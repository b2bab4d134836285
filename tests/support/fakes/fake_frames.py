"""A robot's frames service as the relay sees it (docs/reference/media.md), for unit tests of the relay.

`FakeRobot` serves it on its video port. It keeps the rules: a picture goes out for a credit, and then the newest.
Its misbehaviours have names:

    behaves        keeps the rules
    no_clock_sync  answers no clock sync
    no_service     answers 404, as web_video_server does
    any_page       answers each path with 200, as a server of plain MJPEG may
    full           answers 503, as an agent with too many cameras open does
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
from typing import Any, Literal

from aiohttp import WSMsgType, web

FramesMode = Literal["behaves", "no_clock_sync", "no_service", "any_page", "full"]
STATUSES = {"no_service": 404, "any_page": 200, "full": 503}
HEADER = struct.Struct("!BBHId")
WAIT_S = 30.0


class FakeFrames:
    def __init__(self, clock_ms: Any, mode: FramesMode = "behaves") -> None:
        self.mode = mode
        self.clock_ms = clock_ms
        self.topics: list[str] = []
        self.texts: list[dict[str, Any]] = []
        self.connections: set[web.WebSocketResponse] = set()
        self.credits: dict[web.WebSocketResponse, int] = {}
        self.sequence = 0
        self._newest: tuple[int, bytes] | None = None
        self._changed = asyncio.Event()

    async def serve(self, request: web.Request) -> web.StreamResponse:
        if self.mode in STATUSES:
            return web.Response(status=STATUSES[self.mode])
        socket = web.WebSocketResponse(compress=False, max_msg_size=4096, timeout=0.1)
        await socket.prepare(request)
        self.topics.append(request.query["topic"])
        self.connections.add(socket)
        self.credits[socket] = 0
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await self._handle(socket, json.loads(message.data))
        finally:
            self.connections.discard(socket)
            self._changed.set()
        return socket

    async def show(
        self,
        jpeg: bytes,
        *,
        quality: int = 70,
        codec: int = 1,
        is_key: bool = False,
    ) -> int:
        """Have a picture taken now; it goes out where there is credit. Return its number."""
        self.sequence += 1
        flags = 1 | 2 * is_key
        header = HEADER.pack(codec, flags, quality, self.sequence, self.clock_ms())
        self._newest = (self.sequence, header + jpeg)
        for socket in list(self.connections):
            await self._send(socket)
        return self.sequence

    async def send_status(self, **status: object) -> None:
        await self.send_text({"op": "status", "detail": "", **status})

    async def send_text(self, message: object) -> None:
        for socket in list(self.connections):
            await socket.send_str(json.dumps(message))

    async def send_bytes(self, data: bytes) -> None:
        for socket in list(self.connections):
            await socket.send_bytes(data)

    async def wait_for(self, op: str, **members: object) -> dict[str, Any]:
        async with asyncio.timeout(WAIT_S):
            while True:
                for text in self.texts:
                    if text["op"] == op and members.items() <= text.items():
                        return text
                self._changed.clear()
                await self._changed.wait()

    def of(self, op: str) -> list[dict[str, Any]]:
        return [text for text in self.texts if text["op"] == op]

    async def cut(self) -> None:
        """Break all connections, as a media connection that is lost does."""
        for socket in list(self.connections):
            transport = socket._req.transport if socket._req is not None else None
            if transport is not None:
                transport.abort()

    async def _handle(self, socket: web.WebSocketResponse, message: dict[str, Any]) -> None:
        self.texts.append(message)
        self._changed.set()
        if message["op"] == "clock_sync" and self.mode != "no_clock_sync":
            answer = {"op": "clock_sync", "t_ms": message["t_ms"], "sender_ms": self.clock_ms()}
            await socket.send_str(json.dumps(answer))
        elif message["op"] == "credit":
            self.credits[socket] += message["frames"]
            assert self.credits[socket] <= 2, "the relay has more than two credits open"
            await self._send(socket)

    async def _send(self, socket: web.WebSocketResponse) -> None:
        if self._newest is None or not self.credits[socket]:
            return
        (_, frame), self._newest = self._newest, None
        self.credits[socket] -= 1
        with contextlib.suppress(ConnectionError):
            await socket.send_bytes(frame)

"""A rosbridge with named misbehaviours, for tests of what stands before it.

`good` keeps what it gets and echoes what is published on /echo; `slow_reader` reads nothing from the first message on,
until `read_on`; `refuses` takes no WebSocket.
"""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any, Literal

from aiohttp import WSMsgType, web
from tcp_service import WebService

Mode = Literal["good", "slow_reader", "refuses"]


class FakeRosbridge(WebService):
    scheme = "ws"

    def __init__(self, mode: Mode = "good") -> None:
        super().__init__()
        self.mode = mode
        self.got: list[tuple[float, dict[str, Any]]] = []
        self.raw: list[bytes | str] = []
        self.connections = 0
        self.sockets: list[web.WebSocketResponse] = []
        self._reads = asyncio.Event()
        self._reads.set()

    async def __aexit__(self, *_: object) -> None:
        self.read_on()
        await super().__aexit__()

    def _routes(self) -> dict[str, Any]:
        return {"/": self._serve}

    async def stop(self) -> None:
        for socket in self.sockets:
            transport = socket._req.transport if socket._req else None
            if transport is not None:
                transport.abort()
        await super().stop()

    def read_on(self) -> None:
        self.mode = "good"
        self._reads.set()

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        if self.mode == "refuses":
            return web.Response(status=503)
        socket = web.WebSocketResponse(compress=False, autoping=False, max_msg_size=0, timeout=0.1)
        if not socket.can_prepare(request):
            return web.Response(status=400)
        await socket.prepare(request)
        self.connections += 1
        self.sockets.append(socket)
        while True:
            message = await socket.receive()
            if message.type is WSMsgType.PING:
                await socket.pong(message.data)
            elif message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                await self._take(socket, message.data)
            elif message.type is not WSMsgType.PONG:
                return socket

    async def _take(self, socket: web.WebSocketResponse, data: bytes | str) -> None:
        self.raw.append(data)
        operation = json.loads(data)
        self.got.append((time.monotonic(), operation))
        if self.mode == "slow_reader":
            self._reads.clear()
            if socket._req and isinstance(socket._req.transport, asyncio.ReadTransport):
                socket._req.transport.pause_reading()
                await self._reads.wait()
                socket._req.transport.resume_reading()
        if operation.get("topic") == "/echo":
            await (socket.send_str if isinstance(data, str) else socket.send_bytes)(data)  # type: ignore[arg-type]

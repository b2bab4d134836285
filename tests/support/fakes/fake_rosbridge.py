"""A rosbridge that keeps what it gets and publishes what a test says, with named misbehaviours.

`good` echoes what is published on /echo; `slow_reader` reads nothing from the first message on, until `read_on`;
`refuses` takes no WebSocket, `closes` closes each at once; `stuck` handles nothing more on a connection that has called
a rosapi which is not there.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

from aiohttp import WSMsgType, web
from tcp_service import WebService

Mode = Literal["good", "slow_reader", "refuses", "closes", "stuck"]
WAIT_S = 30.0


class FakeRosbridge(WebService):
    """Its rosapi has `topics` by name and type; None: it has none. `parameters` are of rosbridge itself."""

    scheme = "ws"

    def __init__(
        self, topics: dict[str, str] | None = None, mode: Mode = "good", **parameters: bool
    ) -> None:
        super().__init__()
        self.mode = mode
        self.topics = topics
        self.parameters = parameters
        # What rosapi says of who publishes and who subscribes; None: rosbridge finds no such service.
        self.publishers: list[str] | None = None
        self.subscribers: list[str] | None = None
        # The ids with which a call is answered, one answer each.
        self.answer_ids: Callable[[str], list[Any]] = lambda call_id: [call_id]
        self.got: list[dict[str, Any]] = []
        self.raw: list[bytes | str] = []
        self.sockets: list[web.WebSocketResponse] = []
        self._reads = asyncio.Event()

    @property
    def open(self) -> int:
        return sum(not socket.closed for socket in self.sockets)

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
        for socket in self.sockets:
            # The other end may just leave.
            with suppress(ConnectionError):
                await socket.send_json({"op": "publish", "topic": topic, "msg": message})

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        if self.mode == "refuses":
            return web.Response(status=503)
        socket = web.WebSocketResponse(compress=False, autoping=False, max_msg_size=0, timeout=0.1)
        if not socket.can_prepare(request):
            return web.Response(status=400)
        await socket.prepare(request)
        self.sockets.append(socket)
        if self.mode == "closes":
            await socket.close()
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
        self.got.append(operation)
        if self.mode == "slow_reader":
            self._reads.clear()
            if socket._req and isinstance(socket._req.transport, asyncio.ReadTransport):
                socket._req.transport.pause_reading()
                await self._reads.wait()
                socket._req.transport.resume_reading()
        if operation["op"] == "call_service" and self.topics is not None:
            answer = {"op": "service_response", "result": True, "service": operation["service"]}
            answer["values"] = self._look_up(operation)
            for answer_id in self.answer_ids(operation["id"]):
                await socket.send_json({**answer, "id": answer_id})
        elif operation["op"] == "call_service" and self.mode == "stuck":
            await self._reads.wait()
        elif operation.get("topic") == "/echo":
            await (socket.send_str if isinstance(data, str) else socket.send_bytes)(data)  # type: ignore[arg-type]

    def _look_up(self, operation: dict[str, Any]) -> dict[str, Any]:
        topics = self.topics or {}
        kind = operation["service"].removeprefix("/rosapi/")
        if kind == "topics":
            return {"topics": list(topics), "types": list(topics.values())}
        if kind == "topic_type":
            return {"type": topics.get(operation["args"]["topic"], "")}
        if kind in {"publishers", "subscribers"}:
            return {kind: getattr(self, kind)}
        assert kind == "get_param"
        name = operation["args"]["name"].partition(":")[2]
        return {"value": json.dumps(self.parameters.get(name, ""))}

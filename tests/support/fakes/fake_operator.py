"""A driver's program at the relay.

Unit tests of the relay start it, beside robots of `fake_robot`.
"""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

import aiohttp
from aiohttp import WSMsgType

WAIT_S = 30.0


class FakeOperator:
    """One WebSocket that sends clock syncs and stamped commands, as the drive page does."""

    def __init__(self, http: aiohttp.ClientSession, url: str) -> None:
        self._http = http
        self._url = url
        self.messages: list[dict[str, Any]] = []
        self.closed: tuple[int | None, str] | None = None
        self._ahead_ms: list[float] = []
        self._socket: aiohttp.ClientWebSocketResponse
        self._reader: asyncio.Task[None]

    async def __aenter__(self) -> FakeOperator:
        self._socket = await self._http.ws_connect(self._url, autoping=False, max_msg_size=0)
        self._reader = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_exc: object) -> None:
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)
        await self._socket.close()

    @staticmethod
    def clock_ms() -> float:
        """What the page's clock shows; it began when the page did."""
        return time.monotonic() * 1000 - 5e6

    async def send(self, **message: object) -> None:
        await self._socket.send_str(json.dumps(message))

    async def clock_sync(self) -> None:
        await self.send(op="robotether.clock_sync", t_ms=self.clock_ms())
        await self.until("robotether.clock_sync")

    async def drive(
        self, speed: float, *, age_ms: float = 0.0, topic: str = "/cmd_vel", **stamp: object
    ) -> None:
        """Send a command of an input event that was so long ago; `stamp` are more members beside its time."""
        stamp["t_ms"] = self.clock_ms() - age_ms + max(self._ahead_ms)
        msg = {"linear": {"x": speed}}
        await self.send(op="publish", topic=topic, msg=msg, robotether=stamp)

    async def until(self, what: str) -> dict[str, Any]:
        async with asyncio.timeout(WAIT_S):
            while True:
                for message in self.messages:
                    if message["op"] == what:
                        self.messages.remove(message)
                        return message
                await asyncio.sleep(0.005)

    async def _read(self) -> None:
        while True:
            message = await self._socket.receive()
            if message.type is WSMsgType.PING:
                await self._socket.pong(message.data)
            elif message.type is WSMsgType.TEXT:
                self._handle(json.loads(message.data))
            elif message.type is not WSMsgType.PONG:
                self.closed = (self._socket.close_code, message.extra or "")
                return

    def _handle(self, message: dict[str, Any]) -> None:
        if message["op"] == "robotether.clock_sync":
            self._ahead_ms.append(message["relay_ms"] - self.clock_ms())
        self.messages.append(message)

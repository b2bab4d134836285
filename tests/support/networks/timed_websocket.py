"""WebSockets that keep the time limit of `receive`, which aiohttp's begin anew with each ping that comes."""

from __future__ import annotations

import asyncio
import json
from typing import Any, Self

import aiohttp

WAIT_S = 30.0


class TimedWebSocket(aiohttp.ClientWebSocketResponse):
    """Counts the time limit from the call, whatever pings and pongs come meanwhile."""

    async def receive(self, timeout: float | None = None) -> Any:
        async with asyncio.timeout(timeout):
            return await super().receive()


def timed_session(**options: Any) -> aiohttp.ClientSession:
    return aiohttp.ClientSession(ws_response_class=TimedWebSocket, **options)


class SocketClient:
    """A rosbridge client over a real WebSocket; every wait is bounded."""

    def __init__(self, port: int, **headers: str) -> None:
        self._url = f"ws://127.0.0.1:{port}/"
        self._http = timed_session(headers=headers)
        self.socket: aiohttp.ClientWebSocketResponse

    async def __aenter__(self) -> Self:
        try:
            self.socket = await self._http.ws_connect(self._url, max_msg_size=0)
        except BaseException:
            await self._http.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        # After an error aiohttp calls the socket closed but keeps its connection; only this ends that.
        self.socket._response.close()
        await self._http.close()

    async def send(self, **operation: Any) -> None:
        await self.socket.send_str(json.dumps(operation))

    async def receive(self) -> dict[str, Any]:
        message: dict[str, Any] = await self.socket.receive_json(timeout=WAIT_S)
        return message

    async def ask(self, **operation: Any) -> dict[str, Any]:
        await self.send(**operation)
        while (message := await self.receive())["op"] == "publish":
            pass
        return message

    async def ready(self) -> None:
        answer = await self.ask(op="call_service", service="/rosapi/get_time", id="ready")
        assert answer["id"] == "ready", answer

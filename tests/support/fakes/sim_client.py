"""A rosbridge client over a real WebSocket, and the settings of a simulated robot on free ports."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any, Self

import aiohttp
from sim_robot.settings import SimSettings
from timed_websocket import timed_session

WAIT_S = 30.0
SETTINGS = SimSettings(name="test", bind_address="127.0.0.1", rosbridge_port=0, video_port=0)


class SocketClient:
    """A rosbridge client over a WebSocket; every wait is bounded."""

    def __init__(self, port: int) -> None:
        self._url = f"ws://127.0.0.1:{port}/"
        self._http = timed_session()
        self.socket: aiohttp.ClientWebSocketResponse

    async def __aenter__(self) -> Self:
        self.socket = await self._http.ws_connect(self._url, max_msg_size=0)
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
        """Send one operation and wait for the next message that is no topic's."""
        await self.send(**operation)
        while (message := await self.receive())["op"] == "publish":
            pass
        return message

    async def ready(self) -> None:
        """Wait until the server has done everything that was sent so far."""
        answer = await self.ask(op="call_service", service="/rosapi/get_time", id="ready")
        assert answer["id"] == "ready", answer


async def until(what: str, condition: Callable[[], bool], seconds: float = WAIT_S) -> None:
    """Wait until the condition holds, or fail and say what was awaited."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"after {seconds} s still not: {what}"
        await asyncio.sleep(0.005)

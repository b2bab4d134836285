"""A program that drives: publishes the same twist at 20 Hz on a drive connection, from a thread of its own."""

from __future__ import annotations

import asyncio
import socket

import aiohttp
from local_network import insecure_tls
from loop_thread import LoopThread

RATE_HZ = 20
TWIST = {"linear": {"x": 0.3, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


class ProgramDriver(LoopThread):
    """Drives as long as the `with` block runs, or until the connection ends; `url` has its ticket."""

    # What these tests and experiments bring about.
    endings = (ConnectionError, aiohttp.ClientError)

    def __init__(self, url: str) -> None:
        super().__init__(f"connection to {url.partition('?')[0]}")
        self._url = url
        self._socket: socket.socket | None = None
        self.local_port = 0
        self.close_code: int | None = None

    def cut(self) -> None:
        assert self._socket is not None
        self._socket.shutdown(socket.SHUT_RDWR)

    async def _work(self) -> None:
        async with (
            aiohttp.ClientSession() as http,
            http.ws_connect(self._url, ssl=insecure_tls(), compress=0) as websocket,
        ):
            self.local_port = websocket.get_extra_info("sockname")[1]
            self._socket = websocket.get_extra_info("socket")
            reading = asyncio.create_task(self._read(websocket))
            try:
                await websocket.send_json(
                    {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
                )
                self._begun.set()
                while not websocket.closed:
                    await websocket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": TWIST})
                    await asyncio.sleep(1 / RATE_HZ)
            finally:
                reading.cancel()
                self.close_code = websocket.close_code

    async def _read(self, websocket: aiohttp.ClientWebSocketResponse) -> None:
        async for _ in websocket:
            pass

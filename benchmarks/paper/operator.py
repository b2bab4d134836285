"""An operator's connection to a robot through the stack, from behind an uplink.

    async with aiohttp.ClientSession(connector=connector(uplink)) as http:
        async with Operator(http, world, uplink, "x-spiral-7-1") as operator:
            await operator.send({"op": "publish", "topic": "/cmd_vel", "msg": {...}})

Used by the parts inside their own event loops. The socket is in the uplink's namespace, everything else here.
"""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import aiohttp
from local_network import insecure_tls

from paper.uplinks import Uplink
from paper.world import World


def connector(uplink: Uplink) -> aiohttp.TCPConnector:
    """Connections from inside the uplink, as many as are asked for; the stack's own certificate is not checked.

    Addresses alone: names are looked up outside.
    """

    def make(info: Any) -> socket.socket:
        family, kind, protocol, *_ = info
        with uplink.inside.entered():
            return socket.socket(family, kind, protocol)

    return aiohttp.TCPConnector(socket_factory=make, ssl=insecure_tls(), limit=0)


class Operator:
    """One WebSocket to a robot's rosbridge, as roslibjs opens it; there inside `async with` only."""

    def __init__(
        self,
        http: aiohttp.ClientSession,
        world: World,
        uplink: Uplink,
        robot: str,
        mode: str = "drive",
    ) -> None:
        self._http = http
        self._world = world
        self._robot = robot
        self._mode = mode
        self._url = f"wss://{uplink.machine}:{world.https_port}/robots/{robot}/ros"
        self.sent = 0
        self.received = 0
        # The connection itself, for what is not here.
        self.socket: aiohttp.ClientWebSocketResponse

    async def __aenter__(self) -> Operator:
        ticket = await asyncio.to_thread(self._world.ticket, self._robot, self._mode)
        self.socket = await self._http.ws_connect(
            f"{self._url}?ticket={ticket}",
            max_msg_size=0,
            timeout=aiohttp.ClientWSTimeout(ws_close=2),
        )
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.socket.close()

    async def send(self, message: Mapping[str, object] | str) -> None:
        """Send one rosbridge operation; a text goes as it is."""
        text = message if isinstance(message, str) else json.dumps(message)
        await self.socket.send_str(text)
        self.sent += 1

    async def receive(self, timeout_s: float | None = None) -> str:
        """Return the next message as it came; raise ConnectionError when the connection has ended."""
        message = await self.socket.receive(timeout_s)
        if message.type is not aiohttp.WSMsgType.TEXT:
            raise ConnectionError(
                f"the connection to {self._robot} ended: {self.socket.close_code} {message.extra or message.data}"
            )
        self.received += 1
        return str(message.data)

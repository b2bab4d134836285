"""Programs outside at a site: tickets, connections, and numbered commands that come back to who sent them.

A command says whose it is: its number and that of its connection travel in components that nothing limits here.
"""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

import aiohttp
from local_network import insecure_tls

TOPIC, TYPE = "/cmd_vel", "geometry_msgs/Twist"
SPEED_M_S = 0.2
# Long enough for a cell that is busy, short enough to go to the next one.
REQUEST_S, CLOSE_S = 2.5, 0.3
MAX_WORDS = 90
_NUMBER = re.compile(r"\d+")


class RefusedError(Exception):
    """The server did not do what it was asked, or ended a connection; `code` is a WebSocket's or 0."""

    def __init__(self, why: str, code: int = 0) -> None:
        super().__init__(why)
        self.code = code


# What a person meets and tries again for, or goes to the next cell.
FAILURES = (aiohttp.ClientError, OSError, TimeoutError, RefusedError)


def words_of(error: BaseException) -> str:
    """What stood in the way, in the server's words if it said any."""
    if isinstance(error, aiohttp.WSServerHandshakeError):
        return f"no WebSocket: {error.status}"
    return str(error) if isinstance(error, RefusedError) else type(error).__name__


def new_http(token: str = "", **how: Any) -> aiohttp.ClientSession:
    """As many connections as are asked for, to sites whose certificate is not checked; each shows the token."""
    return aiohttp.ClientSession(
        connector=aiohttp.TCPConnector(ssl=insecure_tls(), limit=0, **how),
        headers={"Authorization": f"Bearer {token}"} if token else None,
    )


class Client:
    def __init__(
        self, http: aiohttp.ClientSession, address: str, token: str, request_s: float = REQUEST_S
    ) -> None:
        self._http, self._address, self._request_s = http, address, request_s
        self._headers = {"Authorization": f"Bearer {token}"}

    @property
    def address(self) -> str:
        return self._address

    async def ask(
        self,
        path: str,
        body: Mapping[str, Any] | None = None,
        *,
        method: str = "POST",
        within_s: float | None = None,
    ) -> dict[str, Any]:
        timeout = aiohttp.ClientTimeout(total=within_s or self._request_s)
        url = f"https://{self.address}/api/v1{path}"
        async with self._http.request(
            method, url, json=body, headers=self._headers, timeout=timeout
        ) as answer:
            text = await answer.text()
            said = json.loads(text) if text.startswith("{") else {}
            if answer.status >= HTTPStatus.BAD_REQUEST:
                code = said.get("code", "")
                raise RefusedError(f"{path.rpartition('/')[2]}: {answer.status} {code}".strip())
            return dict(said)

    async def connect(
        self, robot: str, mode: str = "drive", path: str = "ros", *, straight: bool = False
    ) -> aiohttp.ClientWebSocketResponse:
        """Open a WebSocket with a fresh ticket: at this address, or straight at the cell that the ticket names."""
        ticket = await self.ask("/tickets", {"robot": robot, "mode": mode})
        there = ticket.get("cell") if straight else None
        address = f"{there['host']}:{there['port']}" if there else self.address
        mark = "&" if "?" in path else "?"
        url = f"https://{address}/robots/{robot}/{path}{mark}ticket={ticket['ticket']}"
        async with asyncio.timeout(self._request_s):
            return await self._http.ws_connect(
                url, compress=0, max_msg_size=0, timeout=aiohttp.ClientWSTimeout(ws_close=CLOSE_S)
            )


async def begin(socket: aiohttp.ClientWebSocketResponse) -> None:
    for op in ("advertise", "subscribe"):
        await socket.send_json({"op": op, "topic": TOPIC, "type": TYPE})


def command(number: int, connection: int = 0) -> dict[str, Any]:
    """A rosbridge operation that moves the robot; both numbers are exact in JSON."""
    twist = {
        "linear": {"x": SPEED_M_S, "y": 0.0, "z": 0.0},
        "angular": {"x": float(number), "y": float(connection), "z": 0.0},
    }
    return {"op": "publish", "topic": TOPIC, "msg": twist}


def origin(twist: Mapping[str, Any]) -> tuple[str, int] | None:
    if not twist["linear"]["x"]:
        return None
    return str(round(twist["angular"]["y"])), round(twist["angular"]["x"])


@dataclass
class Echoes:
    # When those were sent that have not come back, by their numbers.
    sent_at: dict[int, float] = field(default_factory=dict)
    round_trips_ms: list[float] = field(default_factory=list)
    # What relay or guard did not pass on, by their words without what differs each time.
    refused: Counter[str] = field(default_factory=Counter)
    count: int = 0
    at_s: float = field(default_factory=time.monotonic)
    _came: asyncio.Event = field(default_factory=asyncio.Event)

    async def listen(self, socket: aiohttp.ClientWebSocketResponse, connection: int = 0) -> None:
        async for frame in socket:
            if frame.type is not aiohttp.WSMsgType.TEXT:
                continue
            said = json.loads(frame.data)
            if said.get("op") == "status":
                self.refused[_NUMBER.sub("N", str(said.get("msg")))[:MAX_WORDS]] += 1
            elif said.get("op") == "publish":
                name, number = origin(said["msg"]) or ("", 0)
                if name == str(connection):
                    self._hear(number)

    def _hear(self, number: int) -> None:
        self.at_s, self.count = time.monotonic(), self.count + 1
        if (sent_at := self.sent_at.pop(number, None)) is not None:
            self.round_trips_ms.append(round((self.at_s - sent_at) * 1000, 2))
            self._came.set()

    async def until_all_came(self) -> None:
        while self.sent_at:
            self._came.clear()
            await self._came.wait()

    @asynccontextmanager
    async def listening(
        self, socket: aiohttp.ClientWebSocketResponse, connection: int = 0
    ) -> AsyncIterator[asyncio.Task[None]]:
        task = asyncio.create_task(self.listen(socket, connection))
        try:
            await begin(socket)
            yield task
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            await close(socket)


async def close(socket: aiohttp.ClientWebSocketResponse) -> None:
    with suppress(*FAILURES):
        async with asyncio.timeout(CLOSE_S):
            await socket.close()

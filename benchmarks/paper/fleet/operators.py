"""The operators of a fleet: who sees that a robot is there, connects to drive, and calls it until it answers.

All are played in the experiment's own process as one user, who may have 32 connections open at once. A robot is
drivable when its rosbridge has answered a call on a connection that drives, behind its guard. What the server refuses
because a robot is not there yet is tried again, and counted by the server's words.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing, suppress
from typing import Any

import aiohttp

from paper.client import FAILURES, MAX_WORDS, Client, RefusedError, close, words_of

# The server lets one user have 32; one that closes still counts for a moment.
AT_ONCE = 28
TRY_AGAIN_S = 0.1
REQUEST_S = 20.0
# Then the call is taken for lost, and another one is made.
ANSWERS_WITHIN_S = 10.0
# Its answer comes on the connection that drives.
CALL = {"op": "call_service", "id": "drivable", "service": "/rosapi/topics"}
# The relay writes something every 10 s.
EVENTS_SILENT_S = 25.0


class Operators:
    def __init__(self, client: Client, http: aiohttp.ClientSession) -> None:
        self._client, self._http = client, http
        self._slots = asyncio.Semaphore(AT_ONCE)
        self._online: set[str] = set()
        self._changed = asyncio.Condition()
        self._began_s = 0.0
        # Since then: when each robot was online and drivable first, and when the server told its fleet, again after a
        # restart; and why operators had to try again.
        self._online_s: dict[str, float] = {}
        self._drivable_s: dict[str, float] = {}
        self._server_s: float | None = None
        self._waits: Counter[str] = Counter()

    def begin(self) -> None:
        self._began_s, self._server_s = time.monotonic(), None
        for seen in (self._online_s, self._drivable_s, self._waits):
            seen.clear()

    async def drive_all(self, robots: Sequence[str], within_s: float) -> dict[str, Any]:
        """Return when each robot has been drivable, or the time is over: what was measured, None for what was not."""
        with suppress(asyncio.TimeoutError):
            async with asyncio.timeout(within_s), asyncio.TaskGroup() as group:
                for robot in robots:
                    group.create_task(self._drive(robot))
        return {
            "drivable_s": [self._drivable_s.get(robot) for robot in robots],
            "online_s": [self._online_s.get(robot) for robot in robots],
            "server_s": self._server_s,
            "waits": dict(self._waits.most_common()),
        }

    async def follow(self) -> None:
        """Follow the server's events until this is cancelled; the connection is made anew for as long as it must."""
        while True:
            with suppress(aiohttp.ClientError, OSError, asyncio.TimeoutError):
                # Whoever ends this while it hears ends the connection, too.
                async with aclosing(self._events()) as events:
                    async for event, data in events:
                        await self._read(event, data)
            await self._become(set())
            await asyncio.sleep(TRY_AGAIN_S)

    def _since(self) -> float:
        return round(time.monotonic() - self._began_s, 4)

    async def _drive(self, robot: str) -> None:
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: robot in self._online)
            async with self._slots:
                try:
                    await self._attempt(robot)
                except FAILURES as error:
                    self._waits[words_of(error)] += 1
                else:
                    self._drivable_s[robot] = self._since()
                    return
            await asyncio.sleep(TRY_AGAIN_S)

    async def _attempt(self, robot: str) -> None:
        """Have a call answered; RefusedError when the server ends the connection or refuses it."""
        socket = await self._client.connect(robot)
        try:
            await socket.send_json(CALL)
            async with asyncio.timeout(ANSWERS_WITHIN_S):
                async for frame in socket:
                    said = json.loads(frame.data) if frame.type is aiohttp.WSMsgType.TEXT else {}
                    if said.get("op") == "service_response":
                        return
                    if said.get("op") == "status" and said.get("level") == "error":
                        raise RefusedError(f"status: {said.get('msg', ''):.{MAX_WORDS}}")
            raise RefusedError(f"closed with {socket.close_code}")
        finally:
            await close(socket)

    async def _events(self) -> AsyncGenerator[tuple[str, Any], None]:
        timeout = aiohttp.ClientTimeout(total=None, sock_read=EVENTS_SILENT_S)
        url = f"https://{self._client.address}/api/v1/events"
        async with self._http.get(url, timeout=timeout) as response:
            response.raise_for_status()
            event = ""
            while line := await response.content.readuntil(b"\n"):
                name, _, value = line.decode().rstrip("\n").partition(": ")
                if name == "event":
                    event = value
                elif name == "data":
                    yield event, json.loads(value)

    async def _read(self, event: str, data: Any) -> None:
        if event == "fleet":
            self._server_s = self._since() if self._server_s is None else self._server_s
            await self._become({robot["name"] for robot in data if robot["online"]})
        elif event == "robot" and data["online"] != (data["name"] in self._online):
            change = {data["name"]}
            await self._become(self._online | change if data["online"] else self._online - change)
        elif event == "removed":
            await self._become(self._online - {data["name"]})

    async def _become(self, online: set[str]) -> None:
        for robot in online - self._online:
            self._online_s.setdefault(robot, self._since())
        async with self._changed:
            self._online = online
            self._changed.notify_all()

"""The operators of a fleet, and what arrived: which robot got its message, when, and what was not meant for it.

Each operator sees on the fleet's events that a robot is there, connects to drive, and sends. All are played in the
experiment's own process as one user, who may have 32 connections open at once. What the server refuses because a robot
is not there yet is waited for, and counted by the server's words. Times are this machine's monotonic clock, which its
processes share.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Iterable, Sequence
from contextlib import aclosing, suppress
from typing import Any

import aiohttp

from paper.client import Client, RefusedError, close
from paper.fleet.worker import TOPIC, TYPE

NS_PER_S = 1e9
# More different wrong texts than this tell nothing new.
MAX_WRONG_TEXTS = 20
# The server lets one user have 32; one that closes still counts for a moment.
AT_ONCE = 28
TRY_AGAIN_S = 0.1
REQUEST_S = 20.0
# Then the message is taken for lost, and another one is sent.
ARRIVES_WITHIN_S = 10.0
# The relay writes something every 10 s.
EVENTS_SILENT_S = 25.0


class Arrivals:
    """One message for each robot, that names the robot and the run."""

    def __init__(self, robots: Sequence[str], run: str, began_ns: int) -> None:
        self._run = run
        self._began_ns = began_ns
        self._arrived = {robot: asyncio.Event() for robot in robots}
        self._message_s: dict[str, float] = {}
        self._online_s: dict[str, float] = {}
        self._server_s: float | None = None
        self._published: Counter[str] = Counter()
        self._received: Counter[str] = Counter()
        self._wrong: list[str] = []
        # Why operators had to try again, in the server's own words.
        self._waits: Counter[str] = Counter()

    def text(self, robot: str) -> str:
        """What an operator sends now; no two texts are the same."""
        self._published[robot] += 1
        return f"{robot} {self._run} {self._published[robot]}"

    def is_online(self, robot: str, at_ns: int) -> None:
        """Note that the server says so; the first time counts."""
        if robot in self._arrived:
            self._online_s.setdefault(robot, self._seconds(at_ns))

    def server_answers(self, at_ns: int) -> None:
        """Note that the server, of which some was restarted, tells of its fleet again; the first time counts."""
        if self._server_s is None:
            self._server_s = self._seconds(at_ns)

    def waits(self, why: str) -> None:
        """Note that a robot could not be reached yet."""
        self._waits[why] += 1

    def got(self, robot: str, text: str, at_ns: int) -> None:
        name, _, rest = text.partition(" ")
        run, _, number = rest.rpartition(" ")
        sent = number.isdecimal() and 1 <= int(number) <= self._published[robot]
        if robot not in self._arrived or (name, run) != (robot, self._run) or not sent:
            self._wrong.append(f"{robot} got {text!r:.100}")
            return
        self._received[robot] += 1
        self._message_s.setdefault(robot, self._seconds(at_ns))
        self._arrived[robot].set()

    def has_arrived(self, robot: str) -> bool:
        return self._arrived[robot].is_set()

    async def until_arrived(self, robot: str) -> None:
        await self._arrived[robot].wait()

    def values(self) -> dict[str, Any]:
        """For the results: lists have one place a robot, null where it did not happen; seconds."""
        return {
            "message_s": [_rounded(self._message_s.get(robot)) for robot in self._arrived],
            "online_s": [_rounded(self._online_s.get(robot)) for robot in self._arrived],
            "server_s": _rounded(self._server_s),
            "published": self._published.total(),
            "received": self._received.total(),
            "wrong": len(self._wrong),
            "wrong_texts": self._wrong[:MAX_WRONG_TEXTS],
            "waits": dict(self._waits.most_common()),
        }

    def _seconds(self, at_ns: int) -> float:
        return (at_ns - self._began_ns) / NS_PER_S


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 4)


class FleetEvents:
    """Which robots are online, by the server's events; the connection is made anew for as long as it must."""

    def __init__(self, http: aiohttp.ClientSession, site: str) -> None:
        self._http, self._site = http, site
        self._online: set[str] = set()
        self._changed = asyncio.Condition()
        self.on_online: Callable[[str, int], None] = lambda _robot, _at_ns: None
        # The server tells the fleet again, after a restart for instance.
        self.on_fleet: Callable[[int], None] = lambda _at_ns: None

    async def follow(self) -> None:
        while True:
            with suppress(aiohttp.ClientError, OSError, asyncio.TimeoutError):
                # Whoever ends this while it hears ends the connection, too.
                async with aclosing(self._events()) as events:
                    async for event, data in events:
                        await self._read(event, data)
            await self._become(set())
            await asyncio.sleep(TRY_AGAIN_S)

    async def until_online(self, robot: str) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: robot in self._online)

    async def _events(self) -> AsyncGenerator[tuple[str, Any], None]:
        timeout = aiohttp.ClientTimeout(total=None, sock_read=EVENTS_SILENT_S)
        async with self._http.get(f"{self._site}/api/v1/events", timeout=timeout) as response:
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
            self.on_fleet(time.monotonic_ns())
            await self._become({robot["name"] for robot in data if robot["online"]})
        elif event == "robot" and data["online"] != (data["name"] in self._online):
            change = {data["name"]}
            await self._become(self._online | change if data["online"] else self._online - change)
        elif event == "removed":
            await self._become(self._online - {data["name"]})

    async def _become(self, online: set[str]) -> None:
        at_ns = time.monotonic_ns()
        for robot in online - self._online:
            self.on_online(robot, at_ns)
        async with self._changed:
            self._online = online
            self._changed.notify_all()


class Operators:
    """All operators of a fleet."""

    def __init__(self, client: Client, fleet_events: FleetEvents) -> None:
        self._client, self._fleet_events = client, fleet_events
        self._slots = asyncio.Semaphore(AT_ONCE)

    async def deliver_all(self, robots: Iterable[str], arrivals: Arrivals, within_s: float) -> None:
        """Return when each robot has got its message, or the time is over."""
        self._fleet_events.on_online, self._fleet_events.on_fleet = (
            arrivals.is_online,
            arrivals.server_answers,
        )
        with suppress(asyncio.TimeoutError):
            async with asyncio.timeout(within_s), asyncio.TaskGroup() as group:
                for robot in robots:
                    group.create_task(self._deliver(robot, arrivals))

    async def _deliver(self, robot: str, arrivals: Arrivals) -> None:
        while not arrivals.has_arrived(robot):
            await self._fleet_events.until_online(robot)
            async with self._slots:
                try:
                    await self._attempt(robot, arrivals)
                except RefusedError as refused:
                    arrivals.waits(str(refused))
                except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                    arrivals.waits(type(error).__name__)
            if not arrivals.has_arrived(robot):
                await asyncio.sleep(TRY_AGAIN_S)

    async def _attempt(self, robot: str, arrivals: Arrivals) -> None:
        socket = await self._client.connect(robot)
        try:
            await socket.send_json({"op": "advertise", "topic": TOPIC, "type": TYPE})
            message = {"data": arrivals.text(robot)}
            await socket.send_json({"op": "publish", "topic": TOPIC, "msg": message})
            async with asyncio.timeout(ARRIVES_WITHIN_S):
                await _until_come(socket, robot, arrivals)
        finally:
            await close(socket)


async def _until_come(
    socket: aiohttp.ClientWebSocketResponse, robot: str, arrivals: Arrivals
) -> None:
    """Wait for the message's arrival; raise RefusedError when the server ends the connection or refuses it."""
    hearing = asyncio.ensure_future(_read(socket))
    coming = asyncio.ensure_future(arrivals.until_arrived(robot))
    try:
        await asyncio.wait({hearing, coming}, return_when=asyncio.FIRST_COMPLETED)
        if not coming.done():
            raise RefusedError(hearing.result())
    finally:
        for task in (hearing, coming):
            task.cancel()
        await asyncio.gather(hearing, coming, return_exceptions=True)


async def _read(socket: aiohttp.ClientWebSocketResponse) -> str:
    """Return why the server ends the connection, or what it does not pass on."""
    async for frame in socket:
        if frame.type is aiohttp.WSMsgType.TEXT:
            answer = json.loads(frame.data)
            if answer.get("op") == "status" and answer.get("level") == "error":
                return f"status: {answer.get('msg', ''):.100}"
    return f"closed with {socket.close_code}"

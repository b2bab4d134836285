"""Many robots that start and come back together: the machinery of `density`.

Agents and virtual robots run in workers (worker.py), behind the addresses of the workers' uplinks. A clock starts with
the order to start, so that no interpreter's start is in it. Robots are enrolled once in a world; the fleet ends with
the `with` block.
"""

from __future__ import annotations

import asyncio
import json
import os
import tempfile
import time
from collections import Counter
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack, aclosing, suppress
from pathlib import Path
from typing import Any

import aiohttp
from namespaces import Namespace
from openssh_server import descendants
from robotether_server.relay.robots.robot import USE_KEPT_S

from paper.client import FAILURES, MAX_WORDS, Client, RefusedError, close, new_http, words_of
from paper.costs import PROC, Reading, cpu_between, memory_between
from paper.fleet.worker import allow_files
from paper.programs import LineProgram
from paper.step import Values
from paper.world import Enrolled, World

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
    """All who drive a fleet, played as one user: each robot is called until it answers, behind its guard.

    What the server refuses because a robot is not there yet is tried again, and counted by the server's words.
    """

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


# Robots have processors of their own. Where hundreds of their processes would push the server's off the two cores that
# both have to share here, what is measured would be how that is decided; so the server comes first while they start.
ASIDE = ("nice", "-n", "19")
SERVICES = ("nginx", "web", "relay", "sshd", "mysql", "recorder")
MOST_IN_A_WORKER, LEAST_WORKERS = 50, 2
# sshd lets 20 log-ins of one address begin at a time, of 60 in all: so few addresses must not be what limits a fleet.
VIRTUAL_IN_A_WORKER = 100
# Larger fleets are watched for longer than a robot may take, to see when the last one comes.
WATCHED_A_ROBOT_S = 0.5
# A robot without an answer after this has failed, whatever comes later.
FAILED_AFTER_S = 60.0
# How many of a fleet are the real agent; all more are virtual robots.
AGENTS = 50
OPENS_WITHIN_S, ENDS_WITHIN_S = 60.0, 120.0
# Also for a relay that holds two connections of each robot, and for this process.
FILES_OF_OPERATORS = 4096
POLL_EVERY_S, SETTLES_IN_POLLS = 0.5, 20
# The relay takes a robot for used for a while after its last operator has left; and two heartbeats more.
UNUSED_AFTER_S = USE_KEPT_S + 4.0
# The agents and the virtual robots of one worker.
Share = tuple[Sequence[Enrolled], Sequence[Enrolled]]


def shares(robots: Sequence[Enrolled], agents: int, most: int = MOST_IN_A_WORKER) -> list[Share]:
    """Divide robots among workers, of which none has more than `most` agents."""
    real, virtual = robots[:agents], robots[agents:]
    return [
        *((some, []) for some in _nearly_equal(real, most)),
        *(([], some) for some in _nearly_equal(virtual, VIRTUAL_IN_A_WORKER)),
    ]


def _nearly_equal(robots: Sequence[Enrolled], most: int) -> list[Sequence[Enrolled]]:
    workers = max(min(LEAST_WORKERS, len(robots)), -(-len(robots) // most))
    return [robots[number::workers] for number in range(workers)]


class Worker(LineProgram):
    def __init__(
        self,
        inside: Namespace,
        log: Path,
        worker_settings: Mapping[str, Any],
        module: str = "paper.fleet.worker",
    ) -> None:
        # What robots said that ended, which none may.
        self.failed: list[str] = []
        super().__init__(module, log, inside.command(*ASIDE))
        self.send(worker_settings)

    def handle(self, message: dict[str, Any]) -> bool:
        if "failed" in message:
            self.failed.append(f"{message['robot']}: {message['failed']}")
        return "failed" in message

    def has_done(self, what: str, within_s: float) -> None:
        said = self.receive(f"that {what} is done", within_s)
        if said["done"] != what:
            raise RuntimeError(f"a worker has done {said['done']} in place of {what}")

    def do(self, what: str, within_s: float, **more: Any) -> None:
        self.send({"do": what, **more})
        self.has_done(what, within_s)


class Fleet:
    """A fleet whose workers stand; its robots run between `start` and `end`."""

    def __init__(
        self,
        world: World,
        robots: Sequence[Enrolled],
        sides: Sequence[Worker],
        operators: Operators,
    ) -> None:
        self._world, self._sides, self._operators = world, sides, operators
        self._names = [robot.name for robot in robots]

    async def start(self) -> dict[str, Any]:
        """Start all robots at once, and return what was measured until each is drivable.

        From then on they go before nobody and after nobody: those that are driven or return would show how a starved
        robot does, and on a site each has a processor of its own.
        """
        values = await self.run(self._start_all)
        no_longer_aside([side.pid for side in self._sides])
        return values

    async def run(self, order: Callable[[], Awaitable[None]]) -> dict[str, Any]:
        """Measure from the moment before `order` is awaited until each robot has answered a call made after it."""
        first = self.reading()
        for side in self._sides:
            side.failed.clear()
        self._operators.begin()
        await order()
        watched_s = max(FAILED_AFTER_S, len(self._names) * WATCHED_A_ROBOT_S)
        seen = await self._operators.drive_all(self._names, watched_s)
        # The robots have their second connections too when it has settled.
        last, settled = self.reading(), await self._settled()
        missing = None in seen["drivable_s"]
        return {
            **seen,
            "took_s": round(last.at_s - first.at_s, 3),
            "cpu_s": cpu_between(first, last),
            "memory_bytes": memory_between(first, settled),
            "failures": [
                *(words for side in self._sides for words in side.failed),
                *(words for side in self._sides if missing and (words := side.tail())),
            ],
        }

    async def idle(self, seconds: float) -> dict[str, Any]:
        await asyncio.sleep(UNUSED_AFTER_S)
        first = await self._settled()
        await asyncio.sleep(seconds)
        last = self.reading()
        return {"idle_s": round(last.at_s - first.at_s, 3), "idle_cpu_s": cpu_between(first, last)}

    async def _start_all(self) -> None:
        for side in self._sides:
            side.send({"do": "start"})
        for side in self._sides:
            await asyncio.to_thread(side.has_done, "start", OPENS_WITHIN_S)

    async def _settled(self) -> Reading:
        """Read when sshd has as many processes as a moment before, or after a while."""
        reading = self.reading()
        for _ in range(SETTLES_IN_POLLS):
            before = reading.services["sshd"].processes
            await asyncio.sleep(POLL_EVERY_S)
            reading = self.reading()
            if reading.services["sshd"].processes == before:
                break
        return reading

    def reading(self) -> Reading:
        containers = {name: self._world.container(name) for name in SERVICES}
        return Reading.now(containers, [side.pid for side in self._sides])


def with_fleet(
    world: World, count: int, agents: int, use: Callable[[Fleet], Awaitable[Values]]
) -> Values:
    """What `use` returns of a fleet none of which has started yet: `agents` light robots, and the others virtual."""
    robots = world.robots(count)
    parts = shares(robots, agents)
    allow_files(FILES_OF_OPERATORS)
    with ExitStack() as stack:
        uplinks = stack.enter_context(world.uplinks(len(parts)))
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rt-fleet-")))
        sides: list[Worker] = []
        for number, (part, uplink) in enumerate(zip(parts, uplinks, strict=True)):
            real, virtual = ({robot.name: robot.settings for robot in some} for some in part)
            order = {"agents": real, "virtual": virtual}
            sides.append(Worker(uplink, logs / f"{number}.log", order))
            stack.callback(sides[-1].end, ENDS_WITHIN_S)
        for side in sides:
            side.has_done("open", OPENS_WITHIN_S)

        async def run() -> Values:
            async with new_http(world.token) as http:
                operators = Operators(Client(http, world.address, world.token, REQUEST_S), http)
                following = asyncio.ensure_future(operators.follow())
                try:
                    return await use(Fleet(world, robots, sides, operators))
                finally:
                    following.cancel()
                    await asyncio.gather(following, return_exceptions=True)

        return asyncio.run(run())


def no_longer_aside(pids: Sequence[int]) -> None:
    """Give these processes, all that they have started, and what these start from now on, the normal priority."""
    for pid in [*pids, *(below for root in pids for below in descendants(root))]:
        # One may have ended meanwhile.
        with suppress(FileNotFoundError, ProcessLookupError):
            # To Linux a priority is a thread's, and one with a lock of the interpreter makes the others wait.
            for thread in (PROC / str(pid) / "task").iterdir():
                os.setpriority(os.PRIO_PROCESS, int(thread.name), 0)

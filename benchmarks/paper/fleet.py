"""Many light robots that start, are ended, and come back together: the machinery of `startup` and `reconnect`.

    values = with_fleet(world, 50, lambda fleet: fleet.start("repetition 7"))

A robot is the real agent with its guard and its own OpenSSH clients, in a worker process with others
(fleet_worker), behind the address of the worker's uplink. A repetition's clock starts with the order to start, so that
no interpreter's start is in it. Robots are enrolled once in a world; the fleet ends with the `with` block.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal, Protocol, TypeVar
from weakref import WeakKeyDictionary

import aiohttp
from local_network import insecure_tls

from paper.enrolled import Enrolled
from paper.fleet_arrivals import Arrivals
from paper.fleet_costs import Reading, cpu_between, limits_met, memory_between
from paper.fleet_groups import FAILED_AFTER_S
from paper.fleet_operators import FleetEvents, Operators
from paper.fleet_worker import LINE_BYTES, allow_files
from paper.profiles import PLAIN
from paper.robots import ASIDE, FOLDERS
from paper.uplinks import Uplink
from paper.world import World

SERVICES = ("nginx", "web", "relay", "sshd", "mysql")
MOST_IN_A_WORKER, LEAST_WORKERS = 50, 2
# Larger fleets are watched for longer than a robot may take, to see when the last one comes.
WATCHED_A_ROBOT_S = 0.5
OPENS_WITHIN_S, ENDS_WITHIN_S = 60.0, 120.0
# Also for a relay that holds two connections of each robot, and for this process.
FILES_OF_OPERATORS = 4096
POLL_EVERY_S, SETTLES_IN_POLLS = 0.5, 20
LOG_LINES = 8
# In place of an order that was done: the worker is no more.
GONE = "gone"

T = TypeVar("T")
# What a world's stack has enrolled is kept for the next fleet in it.
_enrolled: WeakKeyDictionary[World, list[Enrolled]] = WeakKeyDictionary()


def robots_of(world: World, count: int) -> list[Enrolled]:
    """The world's first `count` robots of fleets; those that are missing join now."""
    known = _enrolled.setdefault(world, [])
    if len(known) < count:
        known += world.enrol(world.names("fleet", count - len(known)))
    return known[:count]


def shares(count: int) -> list[int]:
    """How many robots each worker has: at least two workers, none with more than 50 robots, all nearly alike."""
    workers = max(min(LEAST_WORKERS, count), -(-count // MOST_IN_A_WORKER))
    return [count // workers + (at < count % workers) for at in range(workers)]


def watched_s(count: int) -> float:
    """How long it is waited for a fleet's last message."""
    return max(FAILED_AFTER_S, count * WATCHED_A_ROBOT_S)


class WorkerFailedError(Exception):
    """A process of light robots did not do what it was told; says what it logged."""


OnMessage = Callable[[dict[str, Any]], None]


class Side(Protocol):
    """Some robots of a fleet. `pids` are the processes that they are made of now, `heard` is told what they heard."""

    on_message: OnMessage

    @property
    def pids(self) -> Sequence[int]:
        """The processes now; what these have started counts too."""

    async def do(self, order: Literal["start", "end"], within_s: float) -> None:
        """Start or end all its robots."""

    def log_tail(self) -> str:
        """What its robots' agents said last."""


class Worker:
    """One process of light robots; a Side."""

    def __init__(self, process: asyncio.subprocess.Process, log: IO[bytes]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self.pids = [process.pid]
        self.on_message: OnMessage = lambda _: None
        self._process, self._in, self._out, self._log = process, process.stdin, process.stdout, log
        self._done: asyncio.Queue[str] = asyncio.Queue()
        self._listening = asyncio.ensure_future(self._listen())

    @classmethod
    async def start(cls, uplink: Uplink, robots: Sequence[Enrolled], log: IO[bytes]) -> Worker:
        """Start it in the uplink's namespace."""
        environ = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, FOLDERS))}
        process = await asyncio.create_subprocess_exec(
            *uplink.inside.command(*ASIDE, sys.executable, "-m", "paper.fleet_worker"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            limit=LINE_BYTES,
            env=environ,
            # A Ctrl-C is for the experiment, which then ends its robots in order.
            start_new_session=True,
        )
        worker = cls(process, log)
        worker._say({robot.name: robot.settings for robot in robots})
        return worker

    async def do(self, order: str, within_s: float) -> None:
        """Give an order and wait until it is done."""
        self._say(order)
        await self.has_done(order, within_s)

    async def has_done(self, order: str, within_s: float) -> None:
        """Wait until it tells that the order is done."""
        done = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(within_s):
                done = await self._done.get()
        if done != order:
            why = (
                f"it ended when told to {order}" if done == GONE else f"it did not {order} in time"
            )
            raise WorkerFailedError(f"a worker failed, {why}:\n{self.log_tail()}")

    async def end(self) -> None:
        """End it, its robots first."""
        self._in.close()
        try:
            async with asyncio.timeout(ENDS_WITHIN_S):
                await self._process.wait()
        except TimeoutError:
            self._process.kill()
            await self._process.wait()
            raise WorkerFailedError(f"a worker did not end:\n{self.log_tail()}") from None
        finally:
            await self._listening

    def log_tail(self) -> str:
        """What its robots' agents said last."""
        lines = Path(self._log.name).read_text(errors="replace").splitlines()
        return "\n".join(lines[-LOG_LINES:])

    def _say(self, what: object) -> None:
        self._in.write(json.dumps(what).encode() + b"\n")

    async def _listen(self) -> None:
        while line := await self._out.readline():
            message = json.loads(line)
            if "done" in message:
                self._done.put_nowait(message["done"])
            else:
                self.on_message(message)
        # Nobody waits for a worker that has ended.
        self._done.put_nowait(GONE)


@dataclass
class Run:
    """What was measured between an order and the last message."""

    arrivals: Arrivals
    first: Reading
    last: Reading
    # A moment later, when the robots have their second connections too.
    settled: Reading

    def values(self) -> dict[str, Any]:
        """For the results."""
        return {
            **self.arrivals.values(),
            "took_s": round(self.last.at_s - self.first.at_s, 3),
            "cpu_s": cpu_between(self.first, self.last),
            "memory_bytes": memory_between(self.first, self.settled),
            "limits": limits_met(self.first, self.settled),
        }


class Fleet:
    """A fleet whose workers stand; its robots run between `start` and `end`."""

    def __init__(
        self,
        world: World,
        robots: Sequence[Enrolled],
        sides: Sequence[Side],
        http: aiohttp.ClientSession,
    ) -> None:
        site = f"https://{world.address}"
        self._world, self._sides = world, sides
        self._names = [robot.name for robot in robots]
        self.fleet_events = FleetEvents(http, site)
        self._operators = Operators(http, site, self.fleet_events)
        self._failures: list[str] = []

    async def start(self, run: str) -> dict[str, Any]:
        """Start all robots at once, and return what was measured until each has its message."""

        async def order() -> None:
            await asyncio.gather(*(one.do("start", OPENS_WITHIN_S) for one in self._sides))

        return await self.run(run, order)

    async def run(self, run: str, order: Callable[[], Awaitable[None]]) -> dict[str, Any]:
        """Measure from the moment before `order` is awaited until each robot has got a message sent after it."""
        first = self._reading()
        self._failures.clear()
        arrivals = Arrivals(self._names, run, time.monotonic_ns())
        for side in self._sides:
            side.on_message = lambda message: self._on_message(arrivals, message)
        await order()
        await self._operators.deliver_all(self._names, arrivals, watched_s(len(self._names)))
        values = Run(arrivals, first, self._reading(), await self._settled()).values()
        return {**values, "failures": self._failures_of(values)}

    async def idle(self, seconds: float) -> dict[str, Any]:
        """What the fleet costs while nobody uses it: processor time over so many seconds."""
        first = await self._settled()
        await asyncio.sleep(seconds)
        last = self._reading()
        return {
            "idle_s": round(last.at_s - first.at_s, 3),
            "idle_cpu_s": cpu_between(first, last),
        }

    async def end(self) -> float:
        """End all robots, and return the seconds until the server knew of all."""
        began = time.monotonic()
        await asyncio.gather(*(one.do("end", ENDS_WITHIN_S) for one in self._sides))
        async with asyncio.timeout(ENDS_WITHIN_S):
            await self.fleet_events.until(self._names, online=False)
        return round(time.monotonic() - began, 3)

    def _on_message(self, arrivals: Arrivals, message: Mapping[str, Any]) -> None:
        if "got" in message:
            arrivals.got(message["robot"], message["got"], message["at_ns"])
        else:
            self._failures.append(f"{message['robot']}: {message['failed']}")

    def _failures_of(self, values: Mapping[str, Any]) -> list[str]:
        """What explains robots without a message, if there are any."""
        missing = sum(seconds is None for seconds in values["message_s"])
        logs = [side.log_tail() for side in self._sides] if missing else []
        return [*self._failures, *filter(None, logs)]

    async def _settled(self) -> Reading:
        """Read when sshd has as many processes as a moment before, or after a while."""
        reading = self._reading()
        for _ in range(SETTLES_IN_POLLS):
            before = reading.services["sshd"].processes
            await asyncio.sleep(POLL_EVERY_S)
            reading = self._reading()
            if reading.services["sshd"].processes == before:
                break
        return reading

    def _reading(self) -> Reading:
        containers = {name: self._world.container(name) for name in SERVICES}
        return Reading.now(containers, [pid for side in self._sides for pid in side.pids])


def with_fleet(world: World, count: int, use: Callable[[Fleet], Awaitable[T]]) -> T:
    """What `use` returns of a fleet of `count` light robots, none of which has started yet."""
    robots = robots_of(world, count)
    allow_files(FILES_OF_OPERATORS)
    with (
        world.uplinks([PLAIN] * len(shares(count))) as uplinks,
        tempfile.TemporaryDirectory(prefix="rt-fleet-") as logs,
    ):

        async def run() -> T:
            async with (
                workers(robots, uplinks, Path(logs)) as sides,
                following(world, robots, sides) as fleet,
            ):
                return await use(fleet)

        return asyncio.run(run())


@asynccontextmanager
async def following(
    world: World, robots: Sequence[Enrolled], sides: Sequence[Side]
) -> AsyncIterator[Fleet]:
    """The fleet that these robots are, with operators who follow the server's events."""
    headers = {"Authorization": f"Bearer {world.token}"}
    connector = aiohttp.TCPConnector(ssl=insecure_tls(), limit=0)
    async with aiohttp.ClientSession(connector=connector, headers=headers) as http:
        fleet = Fleet(world, robots, sides, http)
        fleet_events = asyncio.ensure_future(fleet.fleet_events.follow())
        try:
            yield fleet
        finally:
            fleet_events.cancel()
            await asyncio.gather(fleet_events, return_exceptions=True)


@asynccontextmanager
async def workers(
    robots: Sequence[Enrolled], uplinks: Sequence[Uplink], logs: Path
) -> AsyncIterator[list[Worker]]:
    """A worker behind each uplink; all robots have their rosbridge, and no agent yet."""
    made, left = [], list(robots)
    async with contextlib.AsyncExitStack() as stack:
        for number, (uplink, share) in enumerate(zip(uplinks, shares(len(robots)), strict=True)):
            log = stack.enter_context((logs / f"{number}.log").open("ab"))
            made.append(await Worker.start(uplink, left[:share], log))
            stack.push_async_callback(made[-1].end)
            del left[:share]
        for worker in made:
            await worker.has_done("open", OPENS_WITHIN_S)
        yield made

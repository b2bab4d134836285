"""What is measured at a site beside the nemesis.

A killed cell, a database that is away, a drain, how work spreads over cells, and what forwarding costs.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import aiohttp

from paper.cells.people import CellAddress, Person
from paper.cells.site import SERVICES, Cell, Site
from paper.cells.workload import Size, Workload, read_database
from paper.client import FAILURES, Echoes, command, new_http
from paper.costs import Reading, cpu_between, use_of
from paper.density.drivers import Drive, Driver, begins
from paper.fleet.operators import FleetEvents
from paper.numbered.messages import Histogram
from paper.step import Values

RATE_HZ, FULL_RATE_HZ = 20, 50
# The relay lets one user have 32 connections.
CONNECTIONS_A_USER = 25
AGAIN_S, HEARD_WITHIN_S, BACK_WITHIN_S = 0.2, 2.0, 60.0
# Drives that are open when the database goes, and that begin without it.
DRIVEN, BEFORE_S, AFTER_S = 10, 5.0, 10.0
BEGUN_WITHIN_S, WRITTEN_WITHIN_S = 10.0, 30.0
# A driven robot is sent to another cell when its drive ends, or 60 s after the drain's begin.
DRAIN_DRIVE_S, DRAINED_WITHIN_S = 30.0, 120.0
# Of one core, for each container of a cell: a cell is a machine of its own, and this one has few cores.
SHARES = {"relay": 0.1, "nginx": 0.06, "sshd": 0.06, "web": 0.1}
PERIOD_US = 50_000
DRIVEN_A_CELL, SPREAD_S = 12, 20.0
ECHO_TOPIC, ECHO_TYPE, ECHO_BYTES = "/echo", "std_msgs/String", 200


@dataclass(frozen=True)
class Probe:
    """How soon one robot was drivable."""

    robot: str
    took_s: float | None


def sessions(site: Site) -> dict[str, str]:
    """Each robot's cell, by the newest open session."""
    rows = site.sql(
        "SELECT r.name, s.cell FROM robot_sessions s JOIN robots r ON r.id = s.robot_id"
        " WHERE s.ended_at IS NULL ORDER BY s.epoch"
    )
    return {robot: cell for robot, cell in rows}  # noqa: C416 (a list of lists is no dict's)


def robots_at(workload: Workload, cell: Cell) -> list[str]:
    where = sessions(workload.site)
    return [robot for robot in workload.robots if where.get(robot) == cell.name]


@contextmanager
def some_robots(site: Site, size: Size) -> Iterator[Workload]:
    """Robots at a site, with a history that nobody reads."""
    with (
        TemporaryDirectory(prefix="rt-cells-") as folder,
        Workload.running(site, size, Path(folder), 0) as workload,
    ):
        yield workload


def person(site: Site, number: int, cell: Cell, http: aiohttp.ClientSession) -> Person:
    """Somebody who is at one cell; so many of them are one user as may be."""
    name = f"x-driver-{number // CONNECTIONS_A_USER + 1}"
    return Person(name, site.tokens(name), [CellAddress(cell.name, cell.address)], http)


# A cell is killed.


def kill_cell(site: Site, size: Size) -> Values:
    """Kill a cell at once; how soon each of its robots is drivable at another."""
    victim, other = site.cells[-1], site.cells[0]
    with some_robots(site, size) as workload:
        robots = robots_at(workload, victim)
        try:
            probes, met, cpu_s = asyncio.run(
                _kill_and_probe_all(site, victim, other, robots, partial(_reading, site, workload))
            )
        finally:
            victim.each(SERVICES, "start")
            victim.wait_live()
    times = [one.took_s for one in probes]
    return {
        "robots": len(robots),
        "of": size.robots,
        "took_s": times,
        "met": dict(met),
        "cpu_s": cpu_s,
    }


def _reading(site: Site, workload: Workload) -> Reading:
    """What the database, the cells that live on, and the robots have used."""
    containers = {
        f"{service} of {cell.name}": cell.container(service)
        for cell in site.cells[:-1]
        for service in SERVICES
    }
    containers["mysql"] = site.cells[0].container("mysql")
    return Reading.now(containers, [one.pid for one in workload.processes.values()])


async def _kill_and_probe_all(
    site: Site, victim: Cell, cell: Cell, robots: Sequence[str], read: Callable[[], Reading]
) -> tuple[list[Probe], Counter[str], dict[str, float]]:
    met: Counter[str] = Counter()
    async with (
        new_http(force_close=True) as http,
        new_http(site.world.token) as following,
    ):
        # All that is no part of a return, such as new tokens, comes before the kill.
        people = [person(site, at, cell, http) for at in range(len(robots))]
        events = FleetEvents(following, f"https://{cell.address}")
        task = asyncio.ensure_future(events.follow())
        try:
            await events.until(robots, online=True)
            before, began = read(), time.monotonic()
            # It returns seconds after the processes have died, which the other cells notice at once.
            killing = asyncio.ensure_future(asyncio.to_thread(victim.each, SERVICES, "kill"))

            async def probe(number: int, who: Person, robot: str) -> Probe:
                gone = asyncio.ensure_future(events.until([robot], online=False))
                await asyncio.wait({killing, gone}, return_when=asyncio.FIRST_COMPLETED)
                gone.cancel()
                return await _probe(who, robot, number, began, events, met)

            probes = await asyncio.gather(*map(probe, range(1, len(robots) + 1), people, robots))
            cpu_s = cpu_between(before, read())
            await killing
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
    return list(probes), met, cpu_s


async def _probe(  # noqa: PLR0917 (one call)
    who: Person,
    robot: str,
    number: int,
    began: float,
    events: FleetEvents,
    met: Counter[str],
) -> Probe:
    with suppress(TimeoutError):
        async with asyncio.timeout(BACK_WITHIN_S):
            while True:
                await events.until([robot], online=True)
                try:
                    await drive_once(who, robot, number)
                except FAILURES as error:
                    who.meet(error)
                else:
                    return Probe(robot, round(time.monotonic() - began, 3))
                finally:
                    met.update(who.met)
                    who.met.clear()
                await asyncio.sleep(AGAIN_S)
    return Probe(robot, None)


async def drive_once(who: Person, robot: str, number: int, ticket: Any = None) -> None:
    """Drive until a command has been heard of the robot; raise what stands in the way."""
    socket = await (who.open(robot, "ros", ticket) if ticket else who.connect(robot))
    echoes = Echoes()
    async with echoes.listening(socket, number) as listening, asyncio.timeout(HEARD_WITHIN_S):
        for sent in count():
            await socket.send_json(command(sent, number))
            await asyncio.wait({listening}, timeout=1 / RATE_HZ)
            if echoes.count:
                return
            if listening.done():
                raise ConnectionError(f"closed with {socket.close_code}")


# The database is away.


def database_away(site: Site, size: Size, away_s: float) -> Values:
    """Drive on without a database, and begin other drives meanwhile, at its loss and before it is back."""
    with some_robots(site, size) as workload:
        others = workload.robots[DRIVEN : 2 * DRIVEN]
        before = _recorded(site, others)
        values = asyncio.run(_database_away(site, workload.robots[:DRIVEN], others, away_s))
        began = Counter(one["robot"] for one in values["begun"] if one["began"])
        values["recorded"] = _recorded_later(site, others, before, began)
        return values


async def _database_away(
    site: Site, driven: Sequence[str], others: Sequence[str], away_s: float
) -> dict[str, Any]:
    seconds = BEFORE_S + away_s + AFTER_S
    cell = site.cells[0]
    async with (
        driving(site, driven, cell, RATE_HZ, seconds) as runs,
        new_http(force_close=True) as http,
    ):
        await asyncio.sleep(BEFORE_S)
        people = [person(site, at, cell, http) for at in range(len(others))]
        pairs = list(zip(people, others, strict=True))
        tickets = await asyncio.gather(*(one.ticket(robot, "drive") for one, robot in pairs))
        await asyncio.to_thread(site.cells[0].each, ["mysql"], "kill")
        back_at = time.monotonic() + away_s
        try:
            begun = await _begin_all(pairs, tickets, 1000)
            await asyncio.sleep(max(0.0, back_at - BEGUN_WITHIN_S - time.monotonic()))
            fresh = await asyncio.gather(
                *(one.ticket(robot, "drive") for one, robot in pairs), return_exceptions=True
            )
            begun += await _begin_all(pairs, fresh, 2000)
            await asyncio.sleep(max(0.0, back_at - time.monotonic()))
        finally:
            await asyncio.to_thread(_start_database, site)
        open_drives = await runs
    return {
        "open": open_drives,
        "away_s": away_s,
        "begun": begun,
        "fresh_tickets": sum(not isinstance(one, BaseException) for one in fresh),
    }


async def _begin_all(
    pairs: Sequence[tuple[Person, str]], tickets: Sequence[Any], number: int
) -> list[dict[str, Any]]:
    return await asyncio.gather(
        *(
            _begin(one, robot, ticket, number + at)
            for at, ((one, robot), ticket) in enumerate(zip(pairs, tickets, strict=True))
        )
    )


def _start_database(site: Site) -> None:
    site.cells[0].each(["mysql"], "start")
    site.cells[0].stack.wait_healthy("mysql")


async def _begin(who: Person, robot: str, ticket: Any, number: int) -> dict[str, Any]:
    began = time.monotonic()
    try:
        if isinstance(ticket, BaseException):
            raise ticket
        async with asyncio.timeout(BEGUN_WITHIN_S):
            await drive_once(who, robot, number, ticket)
    except FAILURES as error:
        return {"robot": robot, "began": False, "why": str(error) or type(error).__name__}
    return {"robot": robot, "began": True, "took_s": round(time.monotonic() - began, 3)}


def _recorded_later(
    site: Site, robots: Sequence[str], before: Counter[str], began: Counter[str]
) -> int:
    """How many of the drives that began meanwhile the database has in the end."""
    end = time.monotonic() + WRITTEN_WITHIN_S
    while True:
        found = ((_recorded(site, robots) - before) & began).total()
        if found == began.total() or time.monotonic() > end:
            return found
        time.sleep(AGAIN_S)


def _recorded(site: Site, robots: Sequence[str]) -> Counter[str]:
    """How many drives of each of these robots the database has."""
    return Counter(robot for robot, _ in read_database(site).drives if robot in robots)


@asynccontextmanager
async def driving(
    site: Site, robots: Sequence[str], cell: Cell, rate_hz: float, seconds: float
) -> AsyncIterator[asyncio.Future[list[Mapping[str, Any]]]]:
    """Drive robots for so long; what becomes of it is awaited."""
    async with new_http() as http:
        drivers = [
            Driver(Drive(robot, site.tokens(_user(at)), "virtual"), cell.address, http)
            for at, robot in enumerate(robots)
        ]
        await asyncio.gather(*(one.open() for one in drivers))

        async def run() -> list[Mapping[str, Any]]:
            moments = begins(len(drivers), rate_hz)
            runs = (one.run(at, rate_hz, seconds) for one, at in zip(drivers, moments, strict=True))
            await asyncio.gather(*runs)
            return [one.result() for one in drivers]

        task = asyncio.ensure_future(run())
        try:
            yield task
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            await asyncio.gather(*(one.close() for one in drivers))


def _user(at: int) -> str:
    return f"x-driver-{at // CONNECTIONS_A_USER + 1}"


# A drain.


def drain(site: Site, size: Size) -> Values:
    """Take a cell out of service while some of its robots are driven; it serves again at the end."""
    victim, other = site.cells[-1], site.cells[0]
    with some_robots(site, size) as workload:
        robots = robots_at(workload, victim)
        try:
            drives, took_s = asyncio.run(_drain(site, victim, robots[:DRIVEN]))
        finally:
            victim.resume()
        online_s = workload.wait_online(BACK_WITHIN_S, [other])
    return {
        "robots": len(robots),
        "drives": drives,
        "drive_s": DRAIN_DRIVE_S,
        "empty_s": took_s,
        "online_s": online_s,
    }


async def _drain(
    site: Site, victim: Cell, driven: Sequence[str]
) -> tuple[list[Mapping[str, Any]], float | None]:
    async with driving(site, driven, victim, RATE_HZ, DRAIN_DRIVE_S) as runs:
        await asyncio.sleep(BEFORE_S)
        began = time.monotonic()
        await asyncio.to_thread(victim.drain)
        drives = await runs
    while time.monotonic() - began < DRAINED_WITHIN_S:
        if victim.name not in (await asyncio.to_thread(sessions, site)).values():
            return drives, round(time.monotonic() - began, 3)
        await asyncio.sleep(AGAIN_S)
    return drives, None


# One, two and three cells.


def spread(site: Site, count: int, robots_a_cell: int) -> Values:
    """What so many cells carry, each with its own share of the processor; the others are off."""
    used, unused = site.cells[:count], site.cells[count:]
    for cell in unused:
        cell.each(SERVICES, "kill")
    try:
        limit(used, SHARES)
        size = Size(cells=count, agents=0, virtual=count * robots_a_cell)
        began = time.monotonic()
        with some_robots(Site.part(site, used), size) as workload:
            online_s = time.monotonic() - began
            cpu = [_cpu_s(one) for one in used]
            drives = asyncio.run(_drive_everywhere(site, used, workload))
            cpu = [round(_cpu_s(one) - before, 3) for one, before in zip(used, cpu, strict=True)]
    finally:
        limit(used, {})
        for cell in unused:
            cell.each(SERVICES, "start")
            cell.wait_live()
    return {
        "cells": count,
        "robots": size.robots,
        "online_s": round(online_s, 3),
        "drives": drives,
        "seconds": SPREAD_S,
        "cpu_s": cpu,
        "share": sum(SHARES.values()),
    }


def limit(cells: Sequence[Cell], shares: Mapping[str, float]) -> None:
    """Give each container its share of a core; without shares, all that there is."""
    for cell in cells:
        for service in SERVICES:
            quota = round(shares[service] * PERIOD_US) if service in shares else -1
            cell.container(service).update(cpu_period=PERIOD_US, cpu_quota=quota)


def _cpu_s(cell: Cell) -> float:
    return sum(use_of(cell.container(service)).cpu_s for service in SERVICES)


async def _drive_everywhere(
    site: Site, cells: Sequence[Cell], workload: Workload
) -> list[Mapping[str, Any]]:
    where = await asyncio.to_thread(sessions, site)
    drives: list[Mapping[str, Any]] = []

    async def at(cell: Cell) -> None:
        robots = [one for one in workload.robots if where.get(one) == cell.name][:DRIVEN_A_CELL]
        async with driving(site, robots, cell, FULL_RATE_HZ, SPREAD_S) as runs:
            drives.extend(await runs)

    await asyncio.gather(*map(at, cells))
    return drives


# What forwarding costs.


def forwarding(site: Site, size: Size, turns: int, messages: int) -> Values:
    """Round trips of a robot's messages through its own cell and through another one, in turns."""
    with some_robots(site, size) as workload:
        where = sessions(site)
        robot = workload.robots[-1]
        own = next(one for one in site.cells if one.name == where[robot])
        other = next(one for one in site.cells if one is not own)
        through: dict[str, Histogram] = {"own": Histogram(), "other": Histogram()}
        for _ in range(turns):
            for name, cell in (("own", own), ("other", other)):
                asyncio.run(_round_trips(site, cell, robot, messages, through[name]))
    return {"bytes": ECHO_BYTES, **{name: one.as_json() for name, one in through.items()}}


async def _round_trips(site: Site, cell: Cell, robot: str, messages: int, times: Histogram) -> None:
    async with new_http(force_close=True) as http:
        who = person(site, 0, cell, http)
        async with await who.connect(robot) as socket:
            for op in ("advertise", "subscribe"):
                await socket.send_json({"op": op, "topic": ECHO_TOPIC, "type": ECHO_TYPE})
            for number in range(-10, messages):
                sent_at = time.monotonic()
                text = str(number).ljust(ECHO_BYTES)
                await socket.send_json(
                    {"op": "publish", "topic": ECHO_TOPIC, "msg": {"data": text}}
                )
                async with asyncio.timeout(HEARD_WITHIN_S):
                    await _until_back(socket, text)
                if number >= 0:
                    times.add((time.monotonic() - sent_at) * 1000)


async def _until_back(socket: aiohttp.ClientWebSocketResponse, text: str) -> None:
    async for frame in socket:
        if frame.type is aiohttp.WSMsgType.TEXT:
            said = json.loads(frame.data)
            if said.get("op") == "publish" and said["msg"].get("data") == text:
                return
    raise ConnectionError(f"closed with {socket.close_code}")

"""How many robots a machine carries: a fleet online, idle, driven, and back after a restart.

Each step starts a fleet of 50 agents and otherwise virtual robots, lets it idle, drives some of it, and then kills all
the server's containers and starts them again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from paper.costs import cpu_between
from paper.density.report import RATE_HZ, report
from paper.fleet.fleet import AGENTS, SERVICES, Fleet, with_fleet
from paper.programs import LineProgram
from paper.step import Part, Scale, Step, Values
from paper.world import World

COUNTS, QUICK_COUNTS = (200, 500, 1000), (20,)
QUICK_AGENTS = 5
IDLE_S, QUICK_IDLE_S = 30.0, 5.0
DRIVEN, DRIVEN_S, QUICK_DRIVEN_S = 50, 60.0, 5.0
READY_WITHIN_S, MORE_S = 90.0, 30.0
SETTLED_AFTER_S = 1.0
# Of those that are driven, so many are agents.
DRIVEN_AGENTS = 10
# The relay lets one user have 32 connections; one that has ended may still count.
DRIVES_A_USER = 25


def steps(scale: Scale) -> Sequence[Step]:
    counts = QUICK_COUNTS if scale.quick else COUNTS
    agents = QUICK_AGENTS if scale.quick else AGENTS
    idle_s = QUICK_IDLE_S if scale.quick else IDLE_S
    driven_s = QUICK_DRIVEN_S if scale.quick else DRIVEN_S
    return [
        Step(
            name=f"fleet-{count}",
            title=f"{count} robots, {agents} of them agents",
            run=partial(_fleet, count, agents, idle_s, driven_s),
        )
        for count in counts
    ]


def _fleet(count: int, agents: int, idle_s: float, driven_s: float, world: World) -> Values:
    """Start, idle, drive, and return after a restart; what fails is told, and the rest goes on."""

    async def use(fleet: Fleet) -> Values:
        values: dict[str, Any] = {"count": count, "agents": agents}
        values["start"] = await fleet.start()
        values["start"] |= await fleet.idle(idle_s)
        values["drive"] = await _unless_failed(
            _drive(world, fleet, _chosen(world, count, agents), driven_s)
        )
        values["return"] = await fleet.run(lambda: asyncio.to_thread(restart_all, world))
        return values

    return with_fleet(world, count, agents, use)


def restart_all(world: World) -> None:
    """Kill the containers and start them again, all at once, as a machine that boots does."""
    with ThreadPoolExecutor(len(SERVICES)) as threads:
        restarted = [
            threads.submit(world.container(service).restart, timeout=0) for service in SERVICES
        ]
    for item in restarted:
        item.result()


async def _unless_failed(measured: Awaitable[dict[str, Any]]) -> dict[str, Any]:
    try:
        return await measured
    except Exception as error:  # noqa: BLE001 (whatever it is, there is no figure; the others are still measured)
        return {"failure": str(error) or type(error).__name__}


def _chosen(world: World, count: int, agents: int) -> list[tuple[str, str]]:
    """Which robots of a fleet are driven, agents and virtual ones: their names and kinds."""
    names = [robot.name for robot in world.robots(count)]
    real = names[: min(agents, DRIVEN_AGENTS)]
    virtual = names[agents : agents + DRIVEN - len(real)]
    return [(name, "agent") for name in real] + [(name, "virtual") for name in virtual]


def tokens(world: World, how_many: int) -> list[str]:
    """An API token for each drive, of as many users as these connections need."""
    users = range(-(-how_many // DRIVES_A_USER))
    of_users = [world.admin_token(f"x-density-{number}") for number in users]
    return [of_users[number // DRIVES_A_USER] for number in range(how_many)]


async def _drive(
    world: World, fleet: Fleet, chosen: Sequence[tuple[str, str]], seconds: float
) -> dict[str, Any]:
    given = await asyncio.to_thread(tokens, world, len(chosen))
    drives = [
        {"robot": name, "kind": kind, "token": token}
        for (name, kind), token in zip(chosen, given, strict=True)
    ]
    with (
        TemporaryDirectory(prefix="rt-drivers-") as folder,
        LineProgram("paper.density.drivers", Path(folder, "log")) as drivers,
    ):
        order = {"site": world.address, "rate_hz": RATE_HZ, "seconds": seconds, "drives": drives}
        drivers.send(order)
        await asyncio.to_thread(drivers.receive, "it has all leases", READY_WITHIN_S)
        first = fleet.reading()
        # Who has taken a robot looks before driving. The leases and this reading are a burst of work.
        await asyncio.sleep(SETTLED_AFTER_S)
        drivers.send("begin")
        figures = await asyncio.to_thread(drivers.receive, "what drivers saw", seconds * 3 + MORE_S)
        return {**figures, "fleet_cpu_s": cpu_between(first, fleet.reading())}


PART = Part(
    name="density",
    title="How many robots a machine carries",
    steps=steps,
    report=report,
)

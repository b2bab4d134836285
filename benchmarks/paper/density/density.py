"""How many robots a machine carries: a fleet online, idle, driven, and back after a restart.

Each step starts a fleet of 50 agents and otherwise virtual robots, lets it idle, drives some of it, drives these again
while the agents among them are recorded, and then kills all the server's containers and starts them again.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
from report import Row, plain, quantiles

from paper.costs import cpu_between
from paper.fleet.fleet import AGENTS, FAILED_AFTER_S, SERVICES, Fleet, with_fleet
from paper.programs import LineProgram
from paper.step import Comparison, Part, Report, Scale, Step, Values, against_aim
from paper.world import World

RATE_HZ = 50
# Of issue 17, on two cores for everything, and of issue 35; those of a start, of idle robots and memory are a robot's.
AIM_RETURN_P50_S = 30.0
AIM_IDLE_MS, AIM_MEMORY_MIB, AIM_START_MS = 0.2, 2.0, 60.0
AIM_DRIVE_P99_MS = 50.0
# Columns of processor time and memory, and whose they are.
SERVER_PARTS = {
    "server": SERVICES,
    "sshd": ("sshd",),
    "relay": ("relay",),
    "nginx, web, database, recorder": ("nginx", "web", "mysql", "recorder"),
}
ROBOTS_SIDE = {"robots' side": ("robots",)}
BESIDE = {**ROBOTS_SIDE, "operators": ("operators",), "rest": ("rest",)}
MIB = 1024 * 1024
MS_PER_S = 1000.0
KINDS = {"agent": "agents", "virtual": "virtual robots"}
Drives = Sequence[Mapping[str, Any]]


class FleetOutcome:
    """A start or a return of a fleet, with the values of Fleet.run, and of Fleet.idle after a start."""

    def __init__(self, count: int, values: Values) -> None:
        self.count, self.values = count, values
        # Seconds until each robot was drivable and online, of those that ever were.
        self.drivable_s, self.online_s = (
            pd.Series(values[name], dtype=float).dropna() for name in ("drivable_s", "online_s")
        )
        self.never = count - len(self.drivable_s)
        self.in_time = int((self.drivable_s <= FAILED_AFTER_S).sum())

    def per_robot(self, values: str, names: Iterable[str]) -> float:
        """Some members of `cpu_s`, `idle_cpu_s` or `memory_bytes` for a robot online; no number without one."""
        used = sum(self.values[values].get(name, 0) for name in names)
        return float(used / (len(self.online_s) or math.nan))

    def start_ms(self, names: Iterable[str] = SERVICES) -> float:
        return self.per_robot("cpu_s", names) * MS_PER_S

    def memory_mib(self, names: Iterable[str] = SERVICES) -> float:
        return self.per_robot("memory_bytes", names) / MIB

    def idle_ms(self, names: Iterable[str] = SERVICES) -> float:
        return self.per_robot("idle_cpu_s", names) * MS_PER_S / float(self.values["idle_s"])

    @property
    def arrivals(self) -> Row:
        return {
            "drivable in time": f"{self.in_time} of {self.count}",
            "later": len(self.drivable_s) - self.in_time,
            "never": self.never,
            **quantiles(self.drivable_s, 0.5, 0.99, 1),
            "tried again": sum(self.values["waits"].values()),
        }

    @property
    def costs(self) -> Row:
        parts = SERVER_PARTS.items()
        beside, idle = (
            {**SERVER_PARTS, **BESIDE}.items(),
            {**SERVER_PARTS, **ROBOTS_SIDE}.items(),
        )
        return {
            "cores busy": sum(self.values["cpu_s"].values()) / self.values["took_s"],
            **{f"start, ms: {name}": self.start_ms(members) for name, members in beside},
            **{f"memory, MiB: {name}": self.memory_mib(members) for name, members in parts},
            **{f"idle, ms a s: {name}": self.idle_ms(members) for name, members in idle},
        }


def report(measured: Mapping[str, Values]) -> Report:
    fleets = list(measured.values())
    titles = [{"robots": f"{fleet['count']}, {fleet['agents']} of them agents"} for fleet in fleets]
    starts = [FleetOutcome(fleet["count"], fleet["start"]) for fleet in fleets]
    returns = [FleetOutcome(fleet["count"], fleet["return"]) for fleet in fleets]
    titled = list(zip(titles, starts, strict=True))
    whole = [start for start in starts if not start.never]
    return Report(
        values={
            "starts": [
                {**title, **start.arrivals, "online p50, s": start.online_s.quantile(0.5)}
                for title, start in titled
            ],
            "costs": [{**title, **start.costs} for title, start in titled],
            "driven": [
                row
                for fleet in fleets
                for recorded, drive in (("none", fleet["drive"]), ("agents", fleet["recorded"]))
                for row in _driven_rows(fleet["count"], recorded, drive)
            ],
            "returns": [
                {
                    "robots": back.count,
                    **back.arrivals,
                    "server answers, s": back.values["server_s"],
                }
                for back in returns
            ],
            "agents": AGENTS,
            "rate_hz": RATE_HZ,
            "failed_after_s": FAILED_AFTER_S,
            "carries": _carries(whole[-1]) if whole else None,
        },
        comparisons=list(_aims(fleets[-1], starts[-1], returns[-1])) if fleets else [],
    )


def _carries(run: FleetOutcome) -> Mapping[str, float]:
    memory = run.memory_mib()
    return {
        "count": run.count,
        "a_core": MS_PER_S / (run.idle_ms() or math.nan),
        "a_gib": 1024 / memory if memory > 0 else math.nan,
    }


def merged(drives: Drives, name: str, *parts: float) -> Mapping[str, float]:
    return quantiles([ms for drive in drives for ms in drive[name]], *parts, unit="ms")


def _driven_rows(count: int, recorded: str, drive: Values) -> Iterable[Row]:
    if "failure" in drive:
        yield {"robots": count, "recorded": recorded, "driven": plain(drive["failure"][:200])}
        return
    used, took_s = drive["fleet_cpu_s"], drive["took_s"]
    for kind, words in KINDS.items():
        if some := [item for item in drive["drives"] if item["kind"] == kind]:
            yield {
                "robots": count,
                "recorded": recorded,
                "driven": f"{len(some)} {words}",
                "commands": sum(item["sent"] for item in some),
                "lost": sum(item["lost"] for item in some),
                "not sent": sum(item["unsent"] for item in some),
                "refusals told": sum(sum(item["refused"].values()) for item in some),
                "connections that ended": sum(sum(item["endings"].values()) for item in some),
                **merged(some, "round_trips_ms", 0.5, 0.99, 1),
                "sent late, p99, ms": merged(some, "late_ms", 0.99)["p99, ms"],
                "server, % of a core": 100 * sum(used[name] for name in SERVICES) / took_s,
                "cores busy": sum(used.values()) / took_s,
                # The drivers are a process of their own.
                "others": (used["rest"] - drive["cpu_s"]) / took_s,
            }


def _aims(fleet: Values, start: FleetOutcome, back: FleetOutcome) -> Iterable[Comparison]:
    drives = fleet["drive"].get("drives", [])
    gone = sum(drive["lost"] + drive["unsent"] for drive in drives) if drives else None
    p99 = merged(drives, "round_trips_ms", 0.99)["p99, ms"]
    for what, aim, ours, unit in (
        (
            "late or never back after all containers restart",
            0.0,
            back.count - back.in_time,
            "robots",
        ),
        (
            "back after all containers restart, p50",
            AIM_RETURN_P50_S,
            back.drivable_s.quantile(0.5),
            "s",
        ),
        ("idle, server's processor a robot and s", AIM_IDLE_MS, start.idle_ms(), "ms"),
        ("server's memory a robot", AIM_MEMORY_MIB, start.memory_mib(), "MiB"),
        ("a start, server's processor a robot", AIM_START_MS, start.start_ms(), "ms"),
        (f"driven at {RATE_HZ} Hz: p99 there and back", AIM_DRIVE_P99_MS, p99, "ms"),
        (f"driven at {RATE_HZ} Hz: lost", 0.0, gone, "commands"),
    ):
        yield against_aim(f"{start.count} robots, {what}", aim, ours, unit)


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

    async def use(fleet: Fleet) -> Values:
        values: dict[str, Any] = {"count": count, "agents": agents}
        values["start"] = await fleet.start()
        values["start"] |= await fleet.idle(idle_s)
        chosen = _chosen(world, count, agents)
        values["drive"] = await _unless_failed(_drive(world, fleet, chosen, driven_s))
        values["recorded"] = await _unless_failed(_drive_recorded(world, fleet, chosen, driven_s))
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


async def _drive_recorded(
    world: World, fleet: Fleet, chosen: Sequence[tuple[str, str]], seconds: float
) -> dict[str, Any]:
    agents = [name for name, kind in chosen if kind == "agent"]
    recordings = await asyncio.to_thread(world.record, agents)
    try:
        return await _drive(world, fleet, chosen, seconds)
    finally:
        await asyncio.to_thread(world.stop_recordings, recordings)


PART = Part(
    name="density",
    title="How many robots a machine carries",
    steps=steps,
    report=report,
)

"""Robotether beside what else a user would take: the same machine, run and emulated link, one way after the other.

Each step stands alone, with a network, a simulated robot and a server's side of its own. It must give every way the
same work, and its programs the settings that their own examples have.
"""

from __future__ import annotations

import asyncio
import random
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from demo import ROOT

from paper import peer_report
from paper.peer_changes import connect_s, recover_patiently_s, recover_s
from paper.peer_echo import behind_video, round_trips
from paper.peer_load import throughput
from paper.peer_ours import Robotether
from paper.peer_plan import (
    CHANGES,
    LATENCY,
    LINK,
    LOAD,
    OURS,
    PATIENCE,
    TITLES,
    Plan,
    name_of,
    plan_of,
)
from paper.peer_ssh import AutoSsh
from paper.peer_vpn import Nebula, OpenVpn, WireGuard
from paper.peer_way import PlainWay, Straight, Way
from paper.step import Part, Scale, Step, Values
from paper.world import World

PEERS: dict[str, type[PlainWay]] = {
    way.key: way for way in (Straight, AutoSsh, WireGuard, OpenVpn, Nebula)
}
MEASURES = {
    LATENCY: "round trips and pictures",
    LOAD: "throughput and its cost",
    CHANGES: "starts and new addresses",
    PATIENCE: "a new address, with a patient operator",
}


@contextmanager
def way_of(world: World, key: str) -> Iterator[Way]:
    """A way over a link of its own, whose robot's side has not been started."""
    if key != OURS:
        ensure(PEERS[key].packages)
    with world.uplinks([LINK]) as [uplink]:
        way = Robotether(world, uplink) if key == OURS else PEERS[key](uplink)
        with way:
            yield way


def ensure(packages: Sequence[str]) -> None:
    """Install others' programs, if they are missing; what a distribution has not got is its way's failure alone."""
    if packages:
        command = [ROOT / "tools" / "ensure_peers", *packages]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"cannot install {' '.join(packages)}: {done.stderr.strip()}")


async def must_connect(way: Way) -> float:
    """Start the robot's side; seconds until a message has passed."""
    took_s = await connect_s(way)
    if took_s is None:
        raise RuntimeError(f"{way.title}: no message has passed; the robot's side:\n{way.words()}")
    return took_s


def measure_latency(plan: Plan, key: str, world: World) -> Values:
    """Round trips idle and behind each video, with the pictures' ages."""

    async def measure(way: Way) -> Values:
        took_s = await must_connect(way)
        idle = await round_trips(way, plan.seconds)
        videos: dict[str, Any] = {}
        for video in way.videos[: plan.videos]:
            videos[video] = await behind_video(way, video, plan.seconds, plan.settle_s)
        return {"connect_s": took_s, "idle_ms": idle, "videos": videos}

    with way_of(world, key) as way:
        return asyncio.run(measure(way))


def measure_load(plan: Plan, key: str, world: World) -> Values:
    """What comes from the robot, and what it costs."""

    async def measure(way: Way) -> Values:
        await must_connect(way)
        return await throughput(way, plan.load_s, plan.load_settle_s)

    with way_of(world, key) as way:
        return asyncio.run(measure(way))


def measure_changes(plan: Plan, key: str, world: World) -> Values:
    """Starts of the robot's side, and new addresses of the robot, as many of each as planned."""
    with way_of(world, key) as way:
        connects = asyncio.run(_starts(way, plan.connects))
    return {"connect_s": connects, "recover_s": _new_addresses(world, key, plan.recovers_of(key))}


def measure_patience(_plan: Plan, key: str, world: World) -> Values:
    """A new address, with an operator who waits for it."""

    async def measure(way: Way) -> Values:
        await must_connect(way)
        return {"patient_s": [await recover_patiently_s(way)]}

    with way_of(world, key) as way:
        return asyncio.run(measure(way))


async def _starts(way: Way, how_many: int) -> list[float | None]:
    took: list[float | None] = []
    for _ in range(how_many):
        await asyncio.to_thread(way.disconnect)
        took.append(await connect_s(way))
    return took


def _new_addresses(world: World, key: str, how_many: int) -> list[float | None]:
    took: list[float | None] = []
    # One that did not come back tells nothing more: the next has everything new.
    while len(took) < how_many:
        with way_of(world, key) as way:
            took += asyncio.run(_until_lost(way, how_many - len(took)))
    return took


async def _until_lost(way: Way, how_many: int) -> list[float | None]:
    rng = random.Random(way.key)
    await must_connect(way)
    took: list[float | None] = []
    while len(took) < how_many and None not in took:
        # A change comes at any moment of a heartbeat.
        took.append(await recover_s(way, rng.uniform(1, 2)))
    return took


MEASURE: dict[str, Callable[[Plan, str, World], Values]] = {
    LATENCY: measure_latency,
    LOAD: measure_load,
    CHANGES: measure_changes,
    PATIENCE: measure_patience,
}


def steps(scale: Scale) -> Sequence[Step]:
    """One step a way and kind of measurement."""
    plan = plan_of(scale)
    return [
        Step(
            name=name_of(key, measure),
            title=f"{TITLES[key]}: {MEASURES[measure]}",
            expected_s=plan.expected_s(key, measure),
            run=partial(MEASURE[measure], plan, key),
        )
        for key, measure in plan.steps()
    ]


PART = Part(
    name="peers",
    title="Against what else a user would take",
    steps=steps,
    report=lambda scale, results: peer_report.report(plan_of(scale), results),
)

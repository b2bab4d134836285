"""Robotether beside what else a user would take: the same machine, run and emulated link, one way after the other.

Each step stands alone, with a network, a simulated robot and a server's side of its own. It must give every way the
same work, and its programs the settings that their own examples have.
"""

from __future__ import annotations

import asyncio
import random
import subprocess
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from demo import ROOT

from paper.peers.measures import (
    behind_video,
    connect_s,
    recover_patiently_s,
    recover_s,
    round_trips,
    throughput,
)
from paper.peers.report import CHANGES, LATENCY, LOAD, PATIENCE, Plan, name_of, plan_of, report
from paper.peers.transports import (
    LINK,
    OURS,
    SSH,
    TITLES,
    AutoSsh,
    PlainTransport,
    Robotether,
    Straight,
    Transport,
)
from paper.peers.vpn import Nebula, OpenVpn, WireGuard
from paper.step import Part, Scale, Step, Values
from paper.world import World

PEERS: dict[str, type[PlainTransport]] = {
    transport.key: transport for transport in (Straight, AutoSsh, WireGuard, OpenVpn, Nebula)
}
MEASURES = {
    LATENCY: "round trips and frames",
    LOAD: "throughput and its cost",
    CHANGES: "starts and new addresses",
    PATIENCE: "a new address, with a patient operator",
}


@contextmanager
def transport_of(world: World, key: str) -> Iterator[Transport]:
    """A way over a link of its own, whose robot's side has not been started."""
    if key != OURS:
        ensure(PEERS[key].packages)
    with world.uplinks([LINK]) as [uplink]:
        transport = Robotether(world, uplink) if key == OURS else PEERS[key](uplink)
        with transport:
            yield transport


def ensure(packages: Sequence[str]) -> None:
    """Install others' programs, if they are missing; what a distribution has not got is its way's failure alone."""
    if packages:
        command = [ROOT / "tools" / "ensure_peers", *packages]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"cannot install {' '.join(packages)}: {done.stderr.strip()}")


async def must_connect(transport: Transport) -> float:
    """Start the robot's side; seconds until a message has passed."""
    took_s = await connect_s(transport)
    if took_s is None:
        raise RuntimeError(
            f"{transport.title}: no message has passed; the robot's side:\n{transport.words()}"
        )
    return took_s


async def measure_latency(plan: Plan, transport: Transport) -> Values:
    """Round trips idle and behind each video, with the frames' ages."""
    took_s = await must_connect(transport)
    idle = await round_trips(transport, plan.seconds)
    videos: dict[str, Any] = {}
    for video in transport.videos[: plan.videos]:
        videos[video] = await behind_video(transport, video, plan.seconds, plan.settle_s)
    return {"connect_s": took_s, "idle_ms": idle, "videos": videos}


async def measure_load(plan: Plan, transport: Transport) -> Values:
    """What comes from the robot, and what it costs."""
    await must_connect(transport)
    return await throughput(transport, plan.load_s, plan.load_settle_s)


async def measure_patience(_plan: Plan, transport: Transport) -> Values:
    """A new address, with an operator who waits for it."""
    await must_connect(transport)
    return {"patient_s": [await recover_patiently_s(transport)]}


def on_one_link(
    measure: Callable[[Plan, Transport], Awaitable[Values]], plan: Plan, key: str, world: World
) -> Values:
    with transport_of(world, key) as transport:
        return asyncio.run(measure(plan, transport))


def measure_changes(plan: Plan, key: str, world: World) -> Values:
    """Starts of the robot's side, and new addresses of the robot, as many of each as planned."""
    with transport_of(world, key) as transport:
        connects = asyncio.run(_starts(transport, plan.connects))
    return {
        "connect_s": connects,
        "recover_s": _new_addresses(world, key, plan.ssh_recovers if key == SSH else plan.recovers),
    }


async def _starts(transport: Transport, how_many: int) -> list[float | None]:
    took: list[float | None] = []
    for _ in range(how_many):
        await asyncio.to_thread(transport.disconnect)
        took.append(await connect_s(transport))
    return took


def _new_addresses(world: World, key: str, how_many: int) -> list[float | None]:
    took: list[float | None] = []
    # One that did not come back tells nothing more: the next has everything new.
    while len(took) < how_many:
        with transport_of(world, key) as transport:
            took += asyncio.run(_until_lost(transport, how_many - len(took)))
    return took


async def _until_lost(transport: Transport, how_many: int) -> list[float | None]:
    rng = random.Random(transport.key)
    await must_connect(transport)
    took: list[float | None] = []
    while len(took) < how_many and None not in took:
        # A change comes at any moment of a heartbeat.
        took.append(await recover_s(transport, rng.uniform(1, 2)))
    return took


MEASURE: dict[str, Callable[[Plan, str, World], Values]] = {
    LATENCY: partial(on_one_link, measure_latency),
    LOAD: partial(on_one_link, measure_load),
    CHANGES: measure_changes,
    PATIENCE: partial(on_one_link, measure_patience),
}


def steps(scale: Scale) -> Sequence[Step]:
    """One step a way and kind of measurement."""
    plan = plan_of(scale)
    return [
        Step(
            name=name_of(key, measure),
            title=f"{TITLES[key]}: {MEASURES[measure]}",
            run=partial(MEASURE[measure], plan, key),
        )
        for key, measure in plan.steps()
    ]


PART = Part(
    name="peers",
    title="Other tunnels",
    steps=steps,
    report=lambda scale, results: report(plan_of(scale), results),
)

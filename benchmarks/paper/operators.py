"""Experiment 5: three operators drive three robots and look at their cameras, over each network of the paper's Table 2.

Each robot is behind a network of its own with the same profile, each operator behind a fixed line. One step is one
network and one quality, first one way and then the other with the same robots, so that what is compared was measured
side by side; which way is first takes turns. One more step a network has the range of qualities that a user has.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial

from paper.operators_plan import ADAPTIVE, NETWORKS, OURS, PLAIN, QUALITIES, ROBOTS, step_name
from paper.operators_report import report
from paper.operators_run import Times, measured
from paper.operators_transports import Pair, Transport, ours, plain
from paper.profiles import FIXED, Profile
from paper.robots import WholeRobot, wait_all_online
from paper.step import Part, Scale, Step, Values
from paper.world import World

TRANSPORTS: Mapping[str, Transport] = {OURS: ours, PLAIN: plain}
USUAL, QUICK = Times(settle_s=5, measure_s=8), Times(settle_s=1.5, measure_s=4)
# Networks, robots and their agents, and all of it taken down again.
SET_UP_S, CONNECT_S = 6.0, 2.0
ONLINE_WITHIN_S = 60.0
# What a robot's machine has where nobody chose; this machine's own default may be another.
CONGESTION_CONTROL = "cubic"


def steps(scale: Scale) -> Sequence[Step]:
    """All of them, in the order of the paper's table."""
    if scale.quick:
        return [_step("4g-7", 50, (OURS,), QUICK), _step("4g-7", 90, (OURS, PLAIN), QUICK)]
    made = []
    for network in NETWORKS:
        for number, quality in enumerate(QUALITIES):
            transports = (OURS, PLAIN) if number % 2 == 0 else (PLAIN, OURS)
            made.append(_step(network, quality, transports, USUAL))
        made.append(_step(network, ADAPTIVE, (OURS,), USUAL))
    return made


def _step(network: str, quality: int | None, transports: Sequence[str], times: Times) -> Step:
    profile = NETWORKS[network]
    what = "the default range of qualities" if quality is None else f"quality {quality}"
    return Step(
        name=step_name(network, quality),
        title=f"{profile.name}, {what}",
        expected_s=SET_UP_S + len(transports) * (CONNECT_S + times.settle_s + times.measure_s),
        run=partial(run, profile=profile, quality=quality, transports=transports, times=times),
    )


def run(
    world: World, *, profile: Profile, quality: int | None, transports: Sequence[str], times: Times
) -> Values:
    """Measure each way, one after the other; the robots are made and removed here."""
    with robots_and_operators(world, profile) as pairs:
        return {
            transport: asyncio.run(_measure(world, pairs, TRANSPORTS[transport], quality, times))
            for transport in transports
        }


async def _measure(
    world: World, pairs: Sequence[Pair], transport: Transport, quality: int | None, times: Times
) -> Values:
    async with transport(world, pairs, quality) as clients:
        return (await measured(clients, times)).as_values()


@contextmanager
def robots_and_operators(world: World, profile: Profile) -> Iterator[list[Pair]]:
    """Three whole simulated robots behind such a network each, online, and a fixed line for each operator."""
    with ExitStack() as stack:
        enrolled = world.enrol(world.names("operators", ROBOTS))
        stack.callback(world.remove, enrolled)
        networks = stack.enter_context(world.uplinks([profile] * ROBOTS + [FIXED] * ROBOTS))
        homes, operators = networks[:ROBOTS], networks[ROBOTS:]
        robots = []
        for one, home in zip(enrolled, homes, strict=True):
            home.inside.sysctl("net.ipv4.tcp_congestion_control", CONGESTION_CONTROL)
            robots.append(stack.enter_context(WholeRobot(world, one, home, ros="simulator")))
        wait_all_online(robots, ONLINE_WITHIN_S)
        yield [Pair(*both) for both in zip(robots, operators, strict=True)]


PART = Part(
    name="operators",
    title="Three operators drive three robots, with video",
    steps=steps,
    report=report,
)

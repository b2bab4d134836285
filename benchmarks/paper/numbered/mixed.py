"""Experiment 3: start and high rate again, with robots and operators behind the networks of the paper's Table 2.

A third of the pairs each is behind a fixed line, a 4G link and another 4G link; then all are behind a link that loses
packets, and behind one that is hardly a link. A pair's operator and robot are behind networks of the same kind, each
robot behind one of its own.
"""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from report import Row, quantiles

from paper.fleet.fleet import Fleet, following, robots_of, workers
from paper.networks import LOSSY, MIXED, WORST, Profile, Uplink
from paper.numbered.report import (
    compared,
    cost_rows,
    delivery_rows,
    flattened,
    latency_figure,
    shortfalls,
)
from paper.numbered.run import Pair, Plan, run
from paper.robots import WholeRobot, wait_all_online
from paper.step import Comparison, Part, Report, Results, Scale, Step, Values, exactly, succeeded
from paper.world import Enrolled, World

RATE_HZ, WORST_HZ = 100, 10
ONLINE_WITHIN_S = 90
# Whose like the paper has: its robots and operators were behind fixed lines and 4G, and none was lost.
PAPERS = "mixed"
ROBOTS_A_NETWORK, QUICK_ROBOTS_A_NETWORK = 2, 1
REPETITIONS, REPETITIONS_WORSE = 10, 3


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Which networks the pairs are behind, one a pair."""

    name: str
    title: str
    profiles: tuple[Profile, ...]


def placements(scale: Scale) -> tuple[Placement, Placement, Placement]:
    """A third each, all where packets are lost, all on the worst."""
    each = QUICK_ROBOTS_A_NETWORK if scale.quick else ROBOTS_A_NETWORK
    count = each * len(MIXED)
    return (
        Placement(
            name="mixed", title="a third each on fixed line, 4G, other 4G", profiles=MIXED * each
        ),
        Placement(name="lossy", title=f"all on {LOSSY.name}", profiles=(LOSSY,) * count),
        Placement(name="worst", title=f"all on {WORST.name}", profiles=(WORST,) * count),
    )


def steps(scale: Scale) -> list[Step]:
    """All starts, then all runs of numbered messages."""
    mixed, lossy, worst = placements(scale)
    if scale.quick:
        return [start_step(mixed, 1, 1), numbered_step(mixed, Plan(count=300, rate_hz=RATE_HZ))]
    count = 100_000 if scale.full else 20_000
    return [
        *(start_step(mixed, number, REPETITIONS) for number in range(1, REPETITIONS + 1)),
        *(
            start_step(placement, number, REPETITIONS_WORSE)
            for placement in (lossy, worst)
            for number in range(1, REPETITIONS_WORSE + 1)
        ),
        numbered_step(mixed, Plan(count=count, rate_hz=RATE_HZ)),
        numbered_step(lossy, Plan(count=2000, rate_hz=RATE_HZ)),
        numbered_step(worst, Plan(count=2000, rate_hz=WORST_HZ)),
    ]


def start_step(placement: Placement, number: int, of: int) -> Step:
    return Step(
        name=f"start-{placement.name}-{number}",
        title=f"start of {len(placement.profiles)} robots, {placement.title}, {number} of {of}",
        run=partial(start, placement, number),
    )


def numbered_step(placement: Placement, plan: Plan) -> Step:
    return Step(
        name=placement.name,
        title=f"{len(placement.profiles)} pairs at {plan.rate_hz:g} Hz, {placement.title}",
        run=partial(numbered, placement, plan),
    )


def start(placement: Placement, number: int, world: World) -> Values:
    """Start light robots at once; seconds to each one's first message, by its network: {"message_s": {NAME: [...]}}."""
    kinds = list(dict.fromkeys(placement.profiles))
    robots = robots_of(world, len(placement.profiles))
    with (
        world.uplinks(kinds) as operators,
        world.uplinks(placement.profiles) as uplinks,
        tempfile.TemporaryDirectory(prefix="rt-mixed-") as logs,
    ):
        placed = list(zip(robots, uplinks, strict=True))
        sides = {
            one: [pair for pair in placed if pair[1].profile == one.profile] for one in operators
        }
        return asyncio.run(_start(world, sides, f"{placement.name}-{number}", Path(logs)))


async def _start(
    world: World,
    sides: Mapping[Uplink, Sequence[tuple[Enrolled, Uplink]]],
    run_name: str,
    logs: Path,
) -> dict[str, Any]:
    async with AsyncExitStack() as stack:
        fleets = [
            await stack.enter_async_context(_fleet(world, operator, robots, logs))
            for operator, robots in sides.items()
        ]
        measured = await asyncio.gather(*(fleet.start(run_name) for fleet in fleets))
        await asyncio.gather(*(fleet.end() for fleet in fleets))
    kinds = [operator.profile.name for operator in sides]
    return {
        name: dict(zip(kinds, (one[name] for one in measured), strict=True))
        for name in ("message_s", "failures")
    }


@asynccontextmanager
async def _fleet(
    world: World, operator: Uplink, robots: Sequence[tuple[Enrolled, Uplink]], logs: Path
) -> AsyncIterator[Fleet]:
    """Robots of one kind of network, each a process behind its own, and the operators behind theirs."""
    places = [(uplink, [one]) for one, uplink in robots]
    async with workers(places, logs) as sides:
        enrolled = [one for one, _ in robots]
        async with following(world, enrolled, sides, operator) as fleet:
            yield fleet


def numbered(placement: Placement, plan: Plan, world: World) -> Values:
    """Send numbered messages to whole robots: {"runs": {NAME: what numbered.run.run returns}}."""
    with _pairs(placement, world) as pairs:
        title = f"{len(pairs)} pairs, {placement.title}"
        return {"runs": {placement.name: {"title": title, **run(world, pairs, plan)}}}


@contextmanager
def _pairs(placement: Placement, world: World) -> Iterator[list[Pair]]:
    with ExitStack() as stack:
        operators = stack.enter_context(world.uplinks(placement.profiles))
        uplinks = stack.enter_context(world.uplinks(placement.profiles))
        enrolled = world.enrol(world.names("mixed", len(uplinks)))
        stack.callback(world.remove, enrolled)
        robots = [
            stack.enter_context(WholeRobot(world, *placed, "bus"))
            for placed in zip(enrolled, uplinks, strict=True)
        ]
        wait_all_online(robots, ONLINE_WITHIN_S)
        yield [Pair(*ends) for ends in zip(operators, robots, strict=True)]


def report(scale: Scale, results: Results) -> Report:
    """The page's part, of the steps that succeeded."""
    done = succeeded(results)
    named = flattened({name: one for name, one in done.items() if "runs" in one})
    runs = list(named.values())
    starts = pd.DataFrame(
        [
            {"placement": placement.title, "kind": kind, "took_s": seconds}
            for placement in placements(scale)
            for step, one in done.items()
            if step.startswith(f"start-{placement.name}-")
            for kind, times in one["message_s"].items()
            for seconds in times
        ],
        columns=["placement", "kind", "took_s"],
    )
    return Report(
        values={
            "starts": start_rows(starts),
            "deliveries": delivery_rows(runs),
            "costs": cost_rows(runs),
            "has_runs": bool(runs),
        },
        comparisons=_comparisons(scale, starts, named),
        shortfalls=[*_late_starts(starts), *shortfalls(runs)],
        figure=latency_figure(runs),
    )


def start_rows(starts: pd.DataFrame) -> list[Row]:
    """A row for each kind of network of each place; `took_s` is empty where no message came."""
    return [
        {
            "networks": placement,
            "robot and operator behind": kind,
            "got their message": f"{some.took_s.count()} of {len(some)}",
            **quantiles(some.took_s, 0.5, 0.99, 1),
        }
        for (placement, kind), some in starts.groupby(["placement", "kind"], sort=False)
    ]


def _comparisons(
    scale: Scale, starts: pd.DataFrame, named: Mapping[str, Values]
) -> list[Comparison]:
    papers = next(one.title for one in placements(scale) if one.name == PAPERS)
    times = starts.took_s[starts.placement == papers]
    rows = [compared(one) for name, one in named.items() if name == PAPERS]
    if len(times):
        what = f"start, {papers}: robots that got their message, of {len(times)}"
        rows.insert(0, exactly(what, "paper", 100, 100 * times.count() / len(times), "%"))
    return rows


def _late_starts(starts: pd.DataFrame) -> list[str]:
    return [
        f"Start, {placement}: {missing} robots of {len(times)} got no message in time."
        for placement, times in starts.groupby("placement", sort=False).took_s
        if (missing := times.isna().sum())
    ]


PART = Part(name="mixed", title="Mixed networks", steps=steps, report=report)

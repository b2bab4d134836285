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

from numpy import quantile
from sections import Section, fixed

from paper.fleet.fleet import Fleet, following, robots_of, workers
from paper.networks import LOSSY, MIXED, WORST, Profile, Uplink
from paper.numbered.report import (
    compared,
    flattened,
    latency_data,
    latency_plot,
    sections,
    shortfalls,
)
from paper.numbered.run import Pair, Plan, run
from paper.robots import WholeRobot, wait_all_online
from paper.step import Comparison, Data, Part, Report, Results, Scale, Step, Values, succeeded
from paper.world import Enrolled, World

RATE_HZ, WORST_HZ = 100, 10
ONLINE_WITHIN_S = 90
# Whose like the paper has: its robots and operators were behind fixed lines and 4G, and none was lost.
PAPERS = "mixed"
START_COLUMNS = "networks | robot and operator behind | got their message | p50 s | p99 s | max s"
START_TEXT = (
    "Light robots (the real agent with its own OpenSSH tunnels, as above) start at once, each behind a "
    "network of its own. Their operators are behind one network of the same kind. The time is from the "
    "order to start until the robot's subscriber has received one std_msgs/String, with ticket and "
    "connection. Each robot without a message after 60 s counts as failed."
)
TEXT = (
    "As in the high rate: whole robots, latency in ms from the time at which the message was due. Each robot and each "
    "operator is behind a network of its own, both of the same kind. A message crosses both, and cannot arrive before "
    "the sum of their delays. Links keep the order, as a radio link that retransmits does. On the worst network 10 "
    "messages a second are sent, because 100 with their headers and acknowledgements are more than half of its "
    "500 kbit/s."
)
CAPTION = "The share of messages that came later than a latency, by the networks; both axes are logarithmic."
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
    """Tables, figure and data of the steps that succeeded."""
    done = succeeded(results)
    named = flattened({name: one for name, one in done.items() if "runs" in one})
    runs = {one["title"]: one for one in named.values()}
    starts = {
        placement: [done[step] for step in done if step.startswith(f"start-{placement.name}-")]
        for placement in placements(scale)
    }
    starts = {placement: some for placement, some in starts.items() if some}
    made, plots = [], []
    if starts:
        made.append(
            Section("Start on mixed networks", START_TEXT, START_COLUMNS, start_rows(starts))
        )
    if runs:
        made += sections("Messages on mixed networks", TEXT, runs)
        plots.append(latency_plot("mixed-latency", CAPTION, runs))
    return Report(
        sections=made,
        comparisons=_comparisons(starts, named),
        plots=plots,
        data=[*latency_data("mixed-latency", named), *([start_data(starts)] if starts else [])],
        shortfalls=[*_late_starts(starts), *shortfalls(runs)],
    )


Starts = Mapping[Placement, Sequence[Values]]


def start_rows(starts: Starts) -> list[tuple[str, ...]]:
    """A row for each kind of network of each place."""
    rows = []
    for placement, some in starts.items():
        for kind in some[0]["message_s"]:
            times = [seconds for one in some for seconds in one["message_s"][kind]]
            received = [seconds for seconds in times if seconds is not None]
            cells = [
                fixed(quantile(received, part) if received else None, 2) for part in (0.5, 0.99, 1)
            ]
            rows.append((placement.title, kind, f"{len(received)} of {len(times)}", *cells))
    return rows


def start_data(starts: Starts) -> Data:
    rows = [
        (placement.name, number, kind, "" if seconds is None else seconds)
        for placement, some in starts.items()
        for number, one in enumerate(some, 1)
        for kind, times in one["message_s"].items()
        for seconds in times
    ]
    about = (
        "Seconds from the order to start until a robot's first message; empty: none came in time"
    )
    return Data(
        name="mixed-start", about=about, header=("networks", "repetition", "network", "seconds"), rows=rows
    )  # fmt: skip


def _comparisons(starts: Starts, named: Mapping[str, Values]) -> list[Comparison]:
    rows = []
    for placement, some in starts.items():
        if placement.name == PAPERS:
            times = _times(some)
            rows.append(
                Comparison(
                    what=f"start, {placement.title}: robots that got their message, of {len(times)}",
                    against="paper",
                    reference=100,
                    ours=100 * sum(seconds is not None for seconds in times) / len(times),
                    unit="%",
                    better="equal",
                )
            )
    rows += [compared(one["title"], one) for name, one in named.items() if name == PAPERS]
    return rows


def _late_starts(starts: Starts) -> list[str]:
    return [
        f"Start, {placement.title}: {missing} robots of {len(_times(some))} got no message in time."
        for placement, some in starts.items()
        if (missing := _times(some).count(None))
    ]


def _times(some: Sequence[Values]) -> list[float | None]:
    return [seconds for one in some for times in one["message_s"].values() for seconds in times]


PART = Part(name="mixed", title="Mixed networks", steps=steps, report=report)

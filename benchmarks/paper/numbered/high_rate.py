"""Experiment 2: many messages a second between pairs of an operator and a robot; none may be lost.

The paper's run is five pairs and 100,000 messages each at 100 Hz. Then the way back, more pairs, and 1000 Hz.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

from paper.numbered.messages import FRAME_BYTES, Histogram
from paper.numbered.report import (
    MICROSECONDS,
    compared,
    cost_rows,
    delivery_rows,
    flattened,
    latency_figure,
    server_cost_s,
    shortfalls,
)
from paper.numbered.run import Plan, run
from paper.robots import WholeRobot, wait_all_online
from paper.step import (
    Comparison,
    Part,
    Report,
    Results,
    Scale,
    Step,
    Values,
    against_aim,
    succeeded,
)
from paper.world import World

PAPERS_RUN = "pairs-5"
# Of issue 17, for the paper's run and for this one.
AIM_COST_US, AIM_P99_MS = 150.0, 20.0
AIMS_RUN = "pairs-20"
RATE_HZ, FAST_HZ = 100, 1000
ONLINE_WITHIN_S, ONLINE_S_A_ROBOT = 60, 5


@dataclass(frozen=True, kw_only=True)
class Run:
    """Messages between so many pairs."""

    name: str
    title: str
    pairs: int
    plan: Plan


def steps(scale: Scale) -> list[Step]:
    """Each with one run or more, one after the other with the same robots, and named as the first."""
    if scale.quick:
        return [_step(pairs(5, 300), back(5, 100), fast(1000))]
    return [
        _step(pairs(5, 100_000)),
        _step(back(5, 10_000)),
        _step(pairs(20, 10_000)),
        _step(pairs(50, 10_000)),
        _step(fast(100_000)),
    ]


def _step(*runs: Run) -> Step:
    title = ", ".join(item.title for item in runs)
    return Step(name=runs[0].name, title=title, run=partial(measure, runs))


def pairs(how_many: int, count: int) -> Run:
    """The paper's way: from operators to robots."""
    title = f"{how_many} pair{'s' * (how_many > 1)}"
    plan = Plan(count=count, rate_hz=RATE_HZ)
    return Run(name=f"pairs-{how_many}", title=title, pairs=how_many, plan=plan)


def back(how_many: int, count: int) -> Run:
    title = f"{how_many} pairs, robot to operator"
    plan = Plan(count=count, rate_hz=RATE_HZ, to_robot=False)
    return Run(name=f"back-{how_many}", title=title, pairs=how_many, plan=plan)


def fast(count: int) -> Run:
    plan = Plan(count=count, rate_hz=FAST_HZ)
    return Run(name="rate-1000", title="1 pair at 1000 Hz", pairs=1, plan=plan)


def measure(runs: Sequence[Run], world: World) -> Values:
    """Start the robots and do all runs: {"runs": {NAME: what numbered.run.run returns}}.

    All operators share one uplink and all robots another, so that they share nothing but the server.
    """
    how_many = max(item.pairs for item in runs)
    with ExitStack() as stack:
        operators, robots = stack.enter_context(world.uplinks(2))
        enrolled = world.enrol(world.names("rate", how_many))
        stack.callback(world.remove, enrolled)
        whole = [stack.enter_context(WholeRobot(world, item, robots)) for item in enrolled]
        wait_all_online(whole, ONLINE_WITHIN_S + ONLINE_S_A_ROBOT * len(whole))
        return {
            "runs": {
                item.name: {
                    "title": item.title,
                    **run(world, operators, whole[: item.pairs], item.plan),
                }
                for item in runs
            }
        }


def report(_scale: Scale, results: Results) -> Report:
    """The page's part, of the runs that succeeded."""
    named = flattened(succeeded(results))
    runs = list(named.values())
    if not runs:
        return Report()
    return Report(
        values={
            "frame_bytes": FRAME_BYTES,
            "deliveries": delivery_rows(runs),
            "costs": cost_rows(runs),
        },
        comparisons=list(_comparisons(named)),
        shortfalls=shortfalls(runs),
        figure=latency_figure(runs),
    )


def _comparisons(named: Mapping[str, Values]) -> Iterator[Comparison]:
    if (papers := named.get(PAPERS_RUN)) is not None:
        yield compared(papers)
        what = f"{papers['title']}: processor for a message, of all server processes"
        yield against_aim(what, AIM_COST_US, server_cost_s(papers) * MICROSECONDS, "µs")
    if (many := named.get(AIMS_RUN)) is not None:
        p99_ms = Histogram(many["latency"]).quantile_ms(0.99)
        yield against_aim(f"{many['title']}: latency at p99", AIM_P99_MS, p99_ms, "ms")


PART = Part(
    name="high-rate",
    title="High rate",
    steps=steps,
    report=report,
)

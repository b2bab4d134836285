"""Experiment 2: many messages a second between pairs of an operator and a robot; none may be lost.

The paper's run is five pairs and 100,000 messages each at 100 Hz. Then the way back, more pairs, 1000 Hz, and a server
with a slow line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from report import Row

from paper.networks import ServerLine, Uplink, server_line
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
# The server's line in Mbit/s, each way.
LADDER = (10, 5, 2, 1)
MEGABIT = 1e6
ONLINE_WITHIN_S, ONLINE_S_A_ROBOT = 60, 5


@dataclass(frozen=True, kw_only=True)
class Run:
    """Messages between so many pairs."""

    name: str
    title: str
    pairs: int
    plan: Plan


@dataclass(frozen=True, kw_only=True)
class Case:
    """The runs of one step, one after the other with the same robots; on a line of the server's, if one is given."""

    runs: Sequence[Run]
    line_mbit_s: float | None = None

    @property
    def robots(self) -> int:
        return max(one.pairs for one in self.runs)

    def step(self) -> Step:
        """It as a step, named as its first run."""
        title = ", ".join(one.title for one in self.runs)
        return Step(name=self.runs[0].name, title=title, run=partial(measure, self))


def cases(scale: Scale) -> list[Case]:
    if scale.quick:
        together = [pairs(5, 300), back(5, 100), fast(1000)]
        return [Case(runs=together), limited(1, 1, 200)]
    return [
        Case(runs=[pairs(5, 100_000)]),
        Case(runs=[back(5, 10_000)]),
        Case(runs=[pairs(20, 10_000)]),
        Case(runs=[pairs(50, 10_000)]),
        Case(runs=[fast(100_000)]),
        *(limited(5, mbit_s, 10_000) for mbit_s in LADDER),
    ]


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


def limited(how_many: int, mbit_s: float, count: int) -> Case:
    """Pairs with the server behind a slow line."""
    usual = pairs(how_many, count)
    title = f"{usual.title}, server's line {mbit_s:g} Mbit/s"
    run = Run(name=f"line-{mbit_s:g}", title=title, pairs=how_many, plan=usual.plan)
    return Case(runs=[run], line_mbit_s=mbit_s)


def measure(case: Case, world: World) -> Values:
    """Start the robots and do all runs: {"runs": {NAME: what numbered.run.run returns}}."""
    with ExitStack() as stack:
        operators, robots, line = stack.enter_context(_networks(case, world))
        enrolled = world.enrol(world.names("rate", case.robots))
        stack.callback(world.remove, enrolled)
        whole = [stack.enter_context(WholeRobot(world, one, robots, "bus")) for one in enrolled]
        wait_all_online(whole, ONLINE_WITHIN_S + ONLINE_S_A_ROBOT * len(whole))
        return {
            "runs": {one.name: _measured(world, operators, whole, one, line) for one in case.runs}
        }


@contextmanager
def _networks(case: Case, world: World) -> Iterator[tuple[Uplink, Uplink, ServerLine | None]]:
    """One for all operators and one for all robots: they share nothing but the server and, if it is slow, its line."""
    if case.line_mbit_s is None:
        with world.uplinks(2) as (operators, robots):
            yield operators, robots, None
    else:
        with server_line(case.line_mbit_s, world.machine) as line:
            yield line.operators, line.robots, line


def _measured(
    world: World,
    operators: Uplink,
    robots: Sequence[WholeRobot],
    one: Run,
    line: ServerLine | None,
) -> dict[str, Any]:
    before = line and line.counts()
    values = {"title": one.title, **run(world, operators, robots[: one.pairs], one.plan)}
    if line is None or before is None:
        return values
    counts = {name: value - before[name] for name, value in line.counts().items()}
    return {**values, "line": {"mbit_s": line.mbit_s, **counts}}


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
            "lines": [_line_row(one) for one in runs if "line" in one],
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


def _line_row(run: Values) -> Row:
    """What the line had to carry, and what became of it."""
    line, planned_s = run["line"], run["planned_s"]
    return {
        "run": run["title"],
        "line Mbit/s": line["mbit_s"],
        # All of it was to pass in the time that the senders were to take.
        "offered to the server": line["to_server_bytes"] * 8 / MEGABIT / planned_s,
        "offered from the server": line["from_server_bytes"] * 8 / MEGABIT / planned_s,
        "packets dropped to it": line["to_server_dropped"],
        "packets dropped from it": line["from_server_dropped"],
        "planned, s": planned_s,
        "sending, s": run["sending_s"],
        "until all came, s": run["took_s"],
    }


PART = Part(
    name="high-rate",
    title="High rate",
    steps=lambda scale: [case.step() for case in cases(scale)],
    report=report,
)

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

from sections import Section

from paper.networks import PLAIN, ServerLine, Uplink, server_line
from paper.numbered.messages import FRAME_BYTES, Histogram
from paper.numbered.report import (
    MICROSECONDS,
    compared,
    flattened,
    latency_data,
    latency_plot,
    sections,
    server_cost_s,
    shortfalls,
)
from paper.numbered.run import Pair, Plan, run
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
TEXT = (
    f"Each message is a std_msgs/String in an operation of {FRAME_BYTES} bytes, with its number. It is published on an "
    "operator's connection (TLS, ticket, relay, tunnel, guard) and received by a subscriber at the robot's own "
    "rosbridge, or in the other direction where the run says so. Robots are the real agent and guard with the "
    "simulated robot's rosbridge. Latency in ms is from the time at which the message was due, so it includes the "
    "sender's lateness, which has columns of its own, and the subscriber's wait for a processor. A run ends when all "
    "messages have come, or after 10 s of silence. Each message is sent once. A connection that ends is dialled again "
    "and counted."
)
LINE_TEXT = (
    "The paper limits the server's bandwidth; its rates are unknown, so these are our own. The limit is on both "
    "directions of one cable in front of the server, for all operators and robots together: the kernel's token bucket, "
    "with a queue of half a second and at least 64 KiB. The load counts all headers and acknowledgements, in Mbit/s "
    "over the time that punctual senders take. If it is more than the line, messages wait in its queue, then in the "
    "senders' sockets; the senders are then late and the run takes longer. The relay ends a driver's connection after "
    "2.5 s of silence, because the robot must not wait longer, and the messages on their way are lost."
)
LINE_COLUMNS = (
    "run | line Mbit/s | offered to the server | from the server | packets dropped to it | from it | planned s "
    "| sending s | until all came s"
)
CAPTION = (
    "The share of messages that came later than a latency, for each run; both axes are logarithmic."
)
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
        ready = [Pair(operators, one) for one in whole]
        return {"runs": {one.name: _measured(world, ready, one, line) for one in case.runs}}


@contextmanager
def _networks(case: Case, world: World) -> Iterator[tuple[Uplink, Uplink, ServerLine | None]]:
    """One for all operators and one for all robots: they share nothing but the server and, if it is slow, its line."""
    if case.line_mbit_s is None:
        with world.uplinks([PLAIN, PLAIN]) as (operators, robots):
            yield operators, robots, None
    else:
        with server_line(case.line_mbit_s, world.machine) as line:
            yield line.operators, line.robots, line


def _measured(
    world: World, ready: Sequence[Pair], one: Run, line: ServerLine | None
) -> dict[str, Any]:
    before = line and line.counts()
    values = {"title": one.title, **run(world, ready[: one.pairs], one.plan)}
    if line is None or before is None:
        return values
    counts = line.counts().since(before)
    return {**values, "line": {"mbit_s": line.operators.profile.up_mbit_s, **counts}}


def report(_scale: Scale, results: Results) -> Report:
    """Tables, figure and data of the runs that succeeded."""
    named = flattened(succeeded(results))
    if not named:
        return Report(sections=())
    runs = {one["title"]: one for one in named.values()}
    lines = [_line_row(title, one) for title, one in runs.items() if "line" in one]
    made = sections("Messages at a high rate", TEXT, runs)
    if lines:
        made.append(Section("A server with a slow line", LINE_TEXT, LINE_COLUMNS, lines))
    return Report(
        sections=made,
        comparisons=list(_comparisons(named)),
        plots=[latency_plot("high-rate-latency", CAPTION, runs)],
        data=latency_data("high-rate-latency", named),
        shortfalls=shortfalls(runs),
    )


def _comparisons(named: Mapping[str, Mapping[str, Any]]) -> Iterator[Comparison]:
    if (papers := named.get(PAPERS_RUN)) is not None:
        yield compared(papers["title"], papers)
        what = f"{papers['title']}: processor for a message, of all server processes"
        yield against_aim(what, AIM_COST_US, server_cost_s(papers) * MICROSECONDS, "µs")
    if (many := named.get(AIMS_RUN)) is not None:
        p99_ms = Histogram.of(many["latency"]).quantile_ms(0.99)
        yield against_aim(f"{many['title']}: latency at p99", AIM_P99_MS, p99_ms, "ms")


def _line_row(title: str, run: Mapping[str, Any]) -> Sequence[str]:
    """What the line had to carry, and what became of it."""
    line = run["line"]
    directions = ("to_server", "from_server")
    # All of it was to pass in the time that the senders were to take.
    offered = [line[f"{way}_bytes"] * 8 / MEGABIT / run["planned_s"] for way in directions]
    return (
        title,
        f"{line['mbit_s']:g}",
        *(f"{rate:.2f}" for rate in offered),
        *(f"{line[f'{way}_dropped']:,}" for way in directions),
        *(f"{run[name]:.1f}" for name in ("planned_s", "sending_s", "took_s")),
    )


PART = Part(
    name="high-rate",
    title="High rate",
    steps=lambda scale: [case.step() for case in cases(scale)],
    report=report,
)

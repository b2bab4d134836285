"""Experiment 2: many messages a second between pairs of an operator and a robot; none may be lost.

The paper's run is five pairs and 100,000 messages each at 100 Hz. Then the way back, more pairs, 1000 Hz, and a server
with a slow line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from sections import Section

from paper import numbered_report
from paper.numbered import FRAME_BYTES
from paper.numbered_report import flattened
from paper.numbered_run import Pair, Plan, run
from paper.profiles import PLAIN
from paper.robots import WholeRobot, wait_all_online
from paper.server_limit import ServerLine, server_line
from paper.step import Part, Report, Results, Scale, Step, Values, succeeded
from paper.uplinks import Uplink
from paper.world import World

PAPERS_RUN = "pairs-5"
RATE_HZ, FAST_HZ = 100, 1000
# The server's line in Mbit/s, each way.
LADDER = (10, 5, 2, 1)
MEGABIT = 1e6
TEXT = (
    f"Each message is a std_msgs/String in an operation of {FRAME_BYTES} bytes, with its number. It is "
    "published on an operator's connection (TLS, ticket, relay, tunnel, guard) and received by a "
    "subscriber at the robot's own rosbridge, or in the other direction where the run says so. Robots are "
    "the real agent and guard with the simulated robot's rosbridge. Latency in ms is from the time at "
    "which the message was due, by this machine's clock. So it includes the sender's lateness, which has "
    "columns of its own, and the subscriber's wait for a processor. A run ends when all messages have "
    "come, or after 10 s of silence. Each message is sent once. A connection that ends is dialled again "
    "and counted."
)
LINE_TEXT = (
    "The paper limits the server's bandwidth. We do not know its rates, so these are our own. The "
    "limit is on both directions of one cable in front of the server, for all operators and robots "
    "together: the kernel's token bucket, with a queue of half a second and at least 64 KiB. The load is "
    "counted on the line, with all headers and acknowledgements, in Mbit/s over the time that punctual "
    "senders take. If it is more than the line, messages wait in its queue, then in the senders' sockets; "
    "the senders are then late and the run takes longer. TCP loses no message. But the relay ends a "
    "driver's connection after 2.5 s of silence, because the robot must not wait longer, and the messages "
    "on their way are lost."
)
LINE_COLUMNS = (
    "run", "line Mbit/s", "offered to the server", "from the server", "packets dropped to it", "from it",
    "planned s", "sending s", "until all came s",
)  # fmt: skip
CAPTION = (
    "The share of messages that came later than a latency, for each run; both axes are logarithmic."
)
# Starting a robot, of which two cores start some at a time; the rest of a step.
ROBOT_S, STEP_S = 2.0, 8
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
        """How many there must be."""
        return max(one.pairs for one in self.runs)

    def step(self) -> Step:
        """It as a step, named as its first run."""
        first = self.runs[0]
        planned_s = sum(one.plan.planned_s for one in self.runs)
        return Step(
            name=first.name,
            title=", ".join(one.title for one in self.runs),
            expected_s=STEP_S + ROBOT_S * self.robots + planned_s,
            run=partial(measure, self),
        )


def cases(scale: Scale) -> list[Case]:
    """What is run, in order."""
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
    plan = Plan(count=count, rate_hz=RATE_HZ)
    return Run(
        name=f"pairs-{how_many}",
        title=f"{how_many} pair{'s' * (how_many > 1)}",
        pairs=how_many,
        plan=plan,
    )


def back(how_many: int, count: int) -> Run:
    """From robots to operators."""
    plan = Plan(count=count, rate_hz=RATE_HZ, to_robot=False)
    return Run(
        name=f"back-{how_many}", title=f"{how_many} pairs, robot to operator", pairs=how_many, plan=plan
    )  # fmt: skip


def fast(count: int) -> Run:
    """One pair at ten times the rate."""
    plan = Plan(count=count, rate_hz=FAST_HZ)
    return Run(name="rate-1000", title="1 pair at 1000 Hz", pairs=1, plan=plan)


def limited(how_many: int, mbit_s: float, count: int) -> Case:
    """Pairs with the server behind a slow line."""
    usual = pairs(how_many, count)
    title = f"{usual.title}, server's line {mbit_s:g} Mbit/s"
    return Case(runs=[replace(usual, name=f"line-{mbit_s:g}", title=title)], line_mbit_s=mbit_s)


def measure(case: Case, world: World) -> Values:
    """Start the robots and do all runs: {"runs": {NAME: what numbered_run.run returns}}."""
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
    return {
        **values,
        "line": {"mbit_s": line.operators.profile.up_mbit_s, **line.counts().since(before)},
    }


def report(scale: Scale, results: Results) -> Report:
    """Tables, figure and data of the runs that succeeded."""
    named = flattened(succeeded(results))
    if not named:
        return Report(sections=())
    runs = {one["title"]: one for one in named.values()}
    lines = {title: one for title, one in runs.items() if "line" in one}
    sections = [
        Section("Messages at a high rate", TEXT, numbered_report.delivery_table(runs)),
        Section("What they cost", numbered_report.COST_TEXT, numbered_report.cost_table(runs)),
    ]
    if lines:
        sections.append(Section("A server with a slow line", LINE_TEXT, line_table(lines)))
    papers = [one for name, one in named.items() if name == PAPERS_RUN]
    return Report(
        sections=sections,
        comparisons=[numbered_report.compared(one["title"], one) for one in papers],
        plots=[numbered_report.latency_plot("high-rate-latency", CAPTION, runs)],
        data=numbered_report.latency_data(named),
        shortfalls=numbered_report.shortfalls(runs),
    )


def line_table(runs: Mapping[str, Values]) -> list[str]:
    """Markdown lines: what the line had to carry, and what became of it."""
    return numbered_report.table(
        LINE_COLUMNS, (_line_row(title, run) for title, run in runs.items())
    )


def _line_row(title: str, run: Values) -> Sequence[str]:
    line = run["line"]
    directions = ("to_server", "from_server")
    # All of it was to pass in the time that the senders were to take.
    offered = [
        line[f"{direction}_bytes"] * 8 / MEGABIT / run["planned_s"] for direction in directions
    ]
    dropped = [line[f"{direction}_dropped"] for direction in directions]
    return (
        title,
        f"{line['mbit_s']:g}",
        *(f"{rate:.2f}" for rate in offered),
        *(f"{packets:,}" for packets in dropped),
        f"{run['planned_s']:.1f}",
        f"{run['sending_s']:.1f}",
        f"{run['took_s']:.1f}",
    )


PART = Part(
    name="high_rate",
    title="High rate",
    steps=lambda scale: [case.step() for case in cases(scale)],
    report=report,
)

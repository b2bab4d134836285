"""The first experiment: N robots start at once, each gets one message through the whole path, and all come back.

The paper starts 50 robots 1000 times, and each gets one std_msgs/String. Here the operator's side is a ticket and a
drive connection through nginx, TLS, relay, tunnel and guard to a subscriber on the robot's ROS side, all in the time
that is measured.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from paper import fleet_report, reconnect
from paper.fleet import Fleet, with_fleet
from paper.fleet_whole import with_whole_fleet
from paper.step import Part, Report, Results, Scale, Step

PAPER_COUNT, PAPER_REPETITIONS = 50, 1000
DEFAULT_REPETITIONS = 20
QUICK_COUNT, QUICK_REPETITIONS = 10, 2
# Once each, to see where this machine ends.
MORE_COUNTS = (200, 500, 1000)
# Of the first repetition of each size: what the fleet costs when nobody uses it.
IDLE_S, QUICK_IDLE_S = 10.0, 2.0


def steps(scale: Scale) -> Sequence[Step]:
    """All starts, then all returns."""
    if scale.quick:
        quick = _repeated(QUICK_COUNT, QUICK_REPETITIONS, QUICK_IDLE_S)
        return [*quick, *reconnect.steps(scale)]
    repetitions = PAPER_REPETITIONS if scale.full else DEFAULT_REPETITIONS
    return [
        *_repeated(PAPER_COUNT, repetitions),
        Step(
            name=f"whole-{PAPER_COUNT}",
            title=f"{PAPER_COUNT} whole robots",
            expected_s=90,
            run=lambda world: with_whole_fleet(world, PAPER_COUNT, _once("whole", IDLE_S)),
        ),
        *(step for count in MORE_COUNTS for step in _repeated(count, 1)),
        *reconnect.steps(scale),
    ]


def _repeated(count: int, repetitions: int, idle_s: float = IDLE_S) -> list[Step]:
    return [
        _step(count, number, repetitions, idle_s if number == 1 else 0.0)
        for number in range(1, repetitions + 1)
    ]


def _step(count: int, number: int, repetitions: int, idle_s: float) -> Step:
    return Step(
        name=f"start-{count}-{number}",
        title=f"{count} robots, repetition {number} of {repetitions}",
        expected_s=6 + count * 0.3 + idle_s,
        run=lambda world: with_fleet(world, count, _once(f"start-{number}", idle_s)),
    )


def _once(run: str, idle_s: float) -> Callable[[Fleet], Awaitable[dict[str, Any]]]:
    async def use(fleet: Fleet) -> dict[str, Any]:
        values = await fleet.start(run)
        if idle_s:
            values |= await fleet.idle(idle_s)
        return {**values, "end_s": await fleet.end()}

    return use


def report(scale: Scale, results: Results) -> Report:
    """The page's part."""
    return fleet_report.report([step.name for step in steps(scale)], results)


PART = Part(name="startup", title="Many robots start at once", steps=steps, report=report)

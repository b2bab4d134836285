"""The first experiment: N robots start at once, each gets one message through the whole path, and all come back.

The paper starts 50 robots 1000 times, and each gets one std_msgs/String. Here the operator's side is a ticket and a
drive connection through nginx, TLS, relay, tunnel and guard to a subscriber on the robot's ROS side, all in the time
that is measured. Beyond the paper, the server's containers are killed, as by a loss of power, and started again: the
clock starts before that, and stops for a robot when it has got a message that an operator sent afterwards.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from report import Figure, arrived

from paper.fleet.fleet import SERVICES, Fleet, with_fleet
from paper.fleet.report import (
    AGENTS,
    FAILED_AFTER_S,
    IN_WORDS,
    Group,
    cost_rows,
    return_rows,
    shortfalls,
    start_rows,
)
from paper.step import Comparison, Part, Report, Results, Scale, Step, Values, exactly
from paper.world import World

PAPER_COUNT, PAPER_REPETITIONS = 50, 1000
DEFAULT_REPETITIONS = 20
QUICK_COUNT, QUICK_REPETITIONS = 10, 2
# Of the first repetition of each size: what the fleet costs when nobody uses it.
IDLE_S, QUICK_IDLE_S = 10.0, 2.0
# What is restarted, by the steps' names.
RESTARTS: Mapping[str, Sequence[str]] = {"tunnels": ("sshd", "relay"), "server": SERVICES}
KILLED_AT_ONCE_S = 0
CAPTION = (
    "Share of the robots that had a message, by the seconds since the order to start, and since the kill of the "
    "containers. A line that does not reach 100 % belongs to a fleet of which some robots never got it."
)


def count_of(scale: Scale) -> int:
    return QUICK_COUNT if scale.quick else PAPER_COUNT


def steps(scale: Scale) -> Sequence[Step]:
    count = count_of(scale)
    returns = [_return_step(count, what) for what in RESTARTS]
    if scale.quick:
        return [*_repeated(count, QUICK_REPETITIONS, QUICK_IDLE_S), *returns]
    repetitions = PAPER_REPETITIONS if scale.full else DEFAULT_REPETITIONS
    return [*_repeated(count, repetitions), *returns]


def _repeated(count: int, repetitions: int, idle_s: float = IDLE_S) -> list[Step]:
    return [
        _step(count, number, repetitions, idle_s if number == 1 else 0.0)
        for number in range(1, repetitions + 1)
    ]


def _step(count: int, number: int, repetitions: int, idle_s: float) -> Step:
    return Step(
        name=f"start-{count}-{number}",
        title=f"{count} robots, repetition {number} of {repetitions}",
        run=lambda world: with_fleet(world, count, _once(f"start-{number}", idle_s)),
    )


def _once(run: str, idle_s: float) -> Callable[[Fleet], Awaitable[dict[str, Any]]]:
    async def use(fleet: Fleet) -> dict[str, Any]:
        values = await fleet.start(run)
        if idle_s:
            values |= await fleet.idle(idle_s)
        return {**values, "end_s": await fleet.end()}

    return use


def _return_step(count: int, what: str) -> Step:
    return Step(
        name=f"reconnect-{count}-{what}",
        title=f"{count} robots come back after a restart of {IN_WORDS[what]}",
        run=lambda world: _return(world, count, what),
    )


def _return(world: World, count: int, what: str) -> Values:
    async def use(fleet: Fleet) -> dict[str, Any]:
        before = await fleet.start(f"before-{what}")
        missing = sum(seconds is None for seconds in before["message_s"])
        if missing:
            raise RuntimeError(
                f"{missing} of {count} robots have not even started: {before['failures']}"
            )
        values = await fleet.run(f"after-{what}", restart)
        return {**values, "count": count, "what": what, "end_s": await fleet.end()}

    async def restart() -> None:
        await asyncio.to_thread(restart_services, world, RESTARTS[what])

    return with_fleet(world, count, use)


def restart_services(world: World, services: Sequence[str]) -> None:
    """Kill the containers and start them again, all at once, as a machine that boots does."""
    with ThreadPoolExecutor(len(services)) as threads:
        restarted = [
            threads.submit(world.container(service).restart, timeout=KILLED_AT_ONCE_S)
            for service in services
        ]
    for item in restarted:
        item.result()


def report(scale: Scale, results: Results) -> Report:
    count = count_of(scale)
    starts = [_group(scale, results, f"start-{count}", f"{count} robots")]
    returns = [
        _group(scale, results, f"reconnect-{count}-{what}", IN_WORDS[what]) for what in RESTARTS
    ]
    starts, returns = [[item for item in some if item.outcomes] for some in (starts, returns)]
    measured = [*starts, *returns]
    lines = [
        arrived(group.title, group.seconds("message_s"), group.wanted).assign(panel=panel)
        for panel, some in (("started", starts), ("restarted", returns))
        for group in some
        if group.runs
    ]
    return Report(
        values={
            "starts": start_rows(starts),
            "costs": cost_rows(starts),
            "returns": return_rows(returns),
            "agents": AGENTS,
            "failed_after_s": FAILED_AFTER_S,
        },
        comparisons=[
            *(_success(item, "start", "paper") for item in starts),
            *(
                _success(outage, f"return after a restart of {outage.title}", "all")
                for outage in returns
            ),
            exactly(
                "messages that reached another robot",
                "none",
                0,
                sum(item.total("wrong") for item in measured),
                "",
            ),
        ],
        shortfalls=[*shortfalls("the start", starts), *shortfalls("the return", returns)],
        figure=Figure(caption=CAPTION, lines=lines, x="s", y="robots, %", log="x"),
    )


def _group(scale: Scale, results: Results, prefix: str, title: str) -> Group:
    """What has run of the steps of this name, and of its repetitions."""
    names = [step.name for step in steps(scale) if f"{step.name}-".startswith(f"{prefix}-")]
    outcomes = [results[name] for name in names if name in results]
    return Group(title, count_of(scale), outcomes, len(names))


def _success(group: Group, what: str, against: str) -> Comparison:
    times = len(group.outcomes)
    what = f"{what}: robots that got their message, {group.count} at once, {times} times"
    return exactly(what, against, 100.0, group.success, "%")


PART = Part(
    name="startup",
    title="Many robots start at once",
    steps=steps,
    report=report,
)

"""The whole fleet comes back after its server has restarted: part of the first experiment, beyond the paper.

The containers are killed, as by a loss of power, and started again. The clock starts before that, and stops for a robot
when it has got a message that an operator sent afterwards.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from paper.fleet import SERVICES, Fleet, with_fleet
from paper.step import Scale, Step, Values
from paper.world import World

# What is restarted, by the steps' names.
RESTARTS: Mapping[str, Sequence[str]] = {"tunnels": ("sshd", "relay"), "server": SERVICES}
IN_WORDS = {"tunnels": "sshd and relay", "server": "all containers, as when the VM restarts"}
KILLED_AT_ONCE_S = 0
DEFAULT_COUNTS, QUICK_COUNTS = (50, 200), (10,)


def steps(scale: Scale) -> list[Step]:
    """One restart of each kind for each size of fleet."""
    counts = QUICK_COUNTS if scale.quick else DEFAULT_COUNTS
    return [_step(count, what) for count in counts for what in RESTARTS]


def _step(count: int, what: str) -> Step:
    return Step(
        name=f"reconnect-{count}-{what}",
        title=f"{count} robots come back after a restart of {IN_WORDS[what]}",
        expected_s=6 + count * 0.5,
        run=lambda world: _measure(world, count, what),
    )


def _measure(world: World, count: int, what: str) -> Values:
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
    for one in restarted:
        one.result()

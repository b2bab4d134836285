"""Takes this cell out of service: sends its robots to the other cells, those first that nobody uses.

`wiring` runs it. Robots stay while no other cell takes them, as they would only come back, and are driven here.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass

from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.robots.registry import SessionRegistry

log = logging.getLogger(__name__)

DETAIL = "the machine is taken out of service; connect to the next"


@dataclass(frozen=True)
class DrainRules:
    """How fast robots go; one that comes to a drained cell found no other, and is sent away after `stays_s`."""

    robots_per_s: float = 20.0
    drives_last_s: float = 60.0
    stays_s: float = 30.0


class CellDrain:
    """Sends robots away for as long as the cell is drained."""

    def __init__(
        self,
        cells: Cells,
        registry: SessionRegistry,
        rules: DrainRules,
    ) -> None:
        self._cells = cells
        self._registry = registry
        self._rules = rules
        self._changed = asyncio.Event()
        cells.listen(self._changed.set)

    async def run(self) -> None:
        """Wait for a drain, and carry it out, for ever."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._cells.draining:
                await self._drain()

    async def _drain(self) -> None:
        began_at = leave_since = time.monotonic()
        log.warning(
            "cell %s is taken out of service; its robots go to the others", self._cells.name
        )
        while self._cells.draining:
            if self._cells.robots_leave():
                # Their drives have had their time.
                with_driven = time.monotonic() - leave_since >= self._rules.drives_last_s
                self._send_one(began_at, with_driven=with_driven)
            else:
                # Drives begin meanwhile.
                leave_since = time.monotonic()
            await asyncio.sleep(1 / self._rules.robots_per_s)
        log.warning("cell %s is in service again", self._cells.name)

    def _send_one(self, began_at: float, *, with_driven: bool) -> None:
        robot_id = min(self._movable(began_at, with_driven=with_driven), default=(0, None))[1]
        if robot_id is not None:
            self._registry.end_links(robot_id, "cell_draining", DETAIL)

    def _movable(self, began_at: float, *, with_driven: bool) -> Iterator[tuple[int, int]]:
        """Rank the robots that may go now: unused, observed, driven."""
        stays_since = max(began_at, time.monotonic() - self._rules.stays_s)
        for robot, connected_at in self._registry.online():
            if connected_at > stays_since:
                continue
            if robot.lease.driver is None:
                yield int(robot.usage.exists), robot.id
            elif with_driven:
                yield 2, robot.id

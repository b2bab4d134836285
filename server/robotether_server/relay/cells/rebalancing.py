"""Sends idle robots from this cell to another that has far fewer, such as one that was away.

`wiring` runs it. Who loses a cell goes to the others, and would stay there: the next loss would move ever more robots.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Robot

DETAIL = "another machine of the server has fewer robots; connect to the next"


@dataclass(frozen=True)
class BalanceRules:
    """When cells are uneven, and how fast robots go.

    They go while this cell has `robots` and `share` of its own more than another. Counts are a second old, and a robot
    takes a second to come back, so both are more than what goes meanwhile. A robot that came within `stays_s` stays.
    """

    robots: int = 20
    share: float = 0.1
    robots_per_s: float = 4.0
    look_every_s: float = 1.0
    stays_s: float = 30.0


class Rebalancing:
    """Evens out what the cells carry.

    `unreached` names the cells that do not follow this one: here robots would count as offline that are there.
    """

    def __init__(
        self,
        cells: Cells,
        registry: SessionRegistry,
        *,
        unreached: Callable[[], Collection[str]],
        rules: BalanceRules | None = None,
    ) -> None:
        self._cells = cells
        self._registry = registry
        self._unreached = unreached
        self._rules = rules or BalanceRules()

    async def run(self) -> None:
        """Look every second, and send robots one after the other, for ever."""
        rules = self._rules
        while True:
            sent = self._send_one()
            await asyncio.sleep(1 / rules.robots_per_s if sent else rules.look_every_s)

    def _send_one(self) -> bool:
        """Send one robot of those that may go; return whether there was one."""
        if self._cells.draining or not self._is_much(self._cells.surplus()[0]):
            return False
        unreached = self._unreached()
        for robot, connected_at in self._registry.online():
            if self._may_go(robot, connected_at):
                surplus, emptiest = self._cells.surplus(robot.id)
                if self._is_much(surplus) and emptiest not in unreached:
                    self._send(robot, emptiest)
                    return True
        return False

    def _is_much(self, surplus: int) -> bool:
        rules = self._rules
        return surplus > max(rules.robots, rules.share * self._registry.online_count())

    def _may_go(self, robot: Robot, connected_at: float) -> bool:
        stays_s, sent_away_at = self._rules.stays_s, robot.sent_away_at
        if sent_away_at is not None and connected_at - sent_away_at < stays_s:
            # It came back at once, so that it cannot reach another cell: it stays.
            return False
        # Nobody knows whether somebody works in a shell.
        # What a guard says of a stop is news for this cell, too.
        is_idle = not (robot.usage.exists or robot.stops.newest or "shell" in robot.links)
        return is_idle and time.monotonic() - connected_at > stays_s

    def _send(self, robot: Robot, cell: str) -> None:
        robot.sent_away_at = time.monotonic()
        if robot.session is not None:
            robot.session.send_cells(self._cells.addresses(robot.id, cell))
        self._registry.end_links(robot.id, "rebalanced", DETAIL)

"""Sends idle robots from this cell to another that has far fewer, such as one that was away.

`main` runs it. Who loses a cell goes to the others, and would stay there: the next loss would move ever more robots.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.robots.sessions import SessionRegistry

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
        is_used: Callable[[int], bool],
        unreached: Callable[[], Collection[str]],
        rules: BalanceRules | None = None,
    ) -> None:
        self._cells = cells
        self._registry = registry
        self._is_used = is_used
        self._unreached = unreached
        self._rules = rules or BalanceRules()
        self._sent_at: dict[int, float] = {}

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
        for robot_id, connected_at in self._registry.online():
            if self._may_go(robot_id, connected_at):
                surplus, emptiest = self._cells.surplus(robot_id)
                if self._is_much(surplus) and emptiest not in unreached:
                    self._send(robot_id, emptiest)
                    return True
        return False

    def _is_much(self, surplus: int) -> bool:
        rules = self._rules
        return surplus > max(rules.robots, rules.share * self._registry.online_count())

    def _may_go(self, robot_id: int, connected_at: float) -> bool:
        stays_s = self._rules.stays_s
        sent_at = self._sent_at.get(robot_id)
        if sent_at is not None and connected_at - sent_at < stays_s:
            # It came back at once, so that it cannot reach another cell: it stays.
            return False
        # Nobody knows whether somebody works in a shell.
        is_idle = not self._is_used(robot_id) and not self._registry.has(robot_id, "shell")
        return is_idle and time.monotonic() - connected_at > stays_s

    def _send(self, robot_id: int, cell: str) -> None:
        self._sent_at[robot_id] = time.monotonic()
        if (session := self._registry.session_of(robot_id)) is not None:
            session.send_cells(self._cells.addresses(robot_id, cell))
        self._registry.end_links(robot_id, "rebalanced", DETAIL)

"""Sends idle robots from this cell to another: one that has far fewer, or one that the robot says is nearer.

`wiring` runs it, and robots' links call `on_nearer`. Robots that lose their cell go to the others, and would stay
there: each loss would move more robots than the last.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from robotether_server.db.cells import SshAddresses
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Robot

DETAIL = "another machine of the server has fewer robots or is nearer; connect to the next"


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
        unreached: Callable[[], Collection[str]],
        rules: BalanceRules,
    ) -> None:
        self._cells = cells
        self._registry = registry
        self._unreached = unreached
        self._rules = rules
        self._moved_at = -math.inf

    def on_nearer(self, robot_id: int, address: SshAddresses) -> None:
        """Send an idle robot to the cell that it asks for, unless that would soon send robots away itself.

        A robot that may not go now asks again in some minutes.
        """
        choice, now = self._cells.choice(robot_id, address), time.monotonic()
        robot, rules = self._registry.robot(robot_id), self._rules
        connected_at = robot.presence.connected_at
        if choice is None or connected_at is None or now - self._moved_at < 1 / rules.robots_per_s:
            return
        cell, surplus = choice
        # Half of what would move robots: so a robot that was sent away for that does not come back at once.
        is_crowded = surplus > max(rules.robots, rules.share * cell.robots) / 2
        is_reached = cell.name not in self._unreached()
        if is_reached and not is_crowded and self._is_idle(robot):
            if self._returned_at_once(robot, connected_at):
                return
            self._moved_at = now
            self._send(robot, cell.name)

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
        if self._returned_at_once(robot, connected_at) or not self._is_idle(robot):
            return False
        return time.monotonic() - connected_at > self._rules.stays_s

    def _returned_at_once(self, robot: Robot, connected_at: float) -> bool:
        """Return whether it was sent away and came back at once: it cannot reach another cell, and stays."""
        sent_away_at = robot.sent_away_at
        return sent_away_at is not None and connected_at - sent_away_at < self._rules.stays_s

    def _is_idle(self, robot: Robot) -> bool:
        # Nobody knows whether somebody works in a shell.
        # What a guard says of a stop is news for this cell, too.
        return not (robot.usage.exists or robot.stops.newest or "shell" in robot.links)

    def _send(self, robot: Robot, cell: str) -> None:
        robot.sent_away_at = time.monotonic()
        if robot.session is not None:
            robot.session.send_cells(self._cells.addresses(robot.id, cell))
        self._registry.end_links(robot.id, "rebalanced", DETAIL)

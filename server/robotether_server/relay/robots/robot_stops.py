"""The stops of one robot, and who waits for its guard to confirm one. Pure, except for its timer."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from robotether_server.db.control import Stop, StopEntry, StopId
from robotether_server.db.fleet import RelayRobot

# Maximum number of stops in force, and of ended ones, that are kept of a robot. A stop whose end was forgotten here may
# come back from a cell that never learned of it.
MAX_STOPS = 32


@dataclass(frozen=True)
class Release:
    """A release that waits for the robot's guard; `answer` fails when somebody stops the robot meanwhile."""

    robot: RelayRobot
    by: str
    address: str | None
    stop_ids: tuple[StopId, ...]
    answer: asyncio.Future[None] = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )


class RobotStops:
    """The stops of one robot: those in force, the newest last, and those that ended last."""

    def __init__(self, robot_id: int) -> None:
        self.entry = StopEntry(robot_id)
        self.in_force: dict[StopId, Stop] = {}
        self.ended: dict[StopId, None] = {}
        # Of the loop's clock: when the stop was last sent to the guard, and when each person last stopped the robot.
        self.sent_at = -math.inf
        self.pressed_at: dict[str, float] = {}
        # The last ones, by person and the id that the client gave it.
        self._presses: dict[tuple[str, str], None] = {}
        self.repeat_timer: asyncio.TimerHandle | None = None
        # Releases that wait for the guard, by the id of the message.
        self.releases: dict[str, Release] = {}
        # Requests that wait until the guard has the stop.
        self.confirmations: list[asyncio.Future[None]] = []

    @property
    def newest(self) -> Stop | None:
        """The newest stop in force; None: the robot is not stopped."""
        return self.entry.stop

    def knows(self, stop_id: StopId) -> bool:
        """Return whether the stop was here before."""
        return stop_id in self.in_force or stop_id in self.ended

    def is_new_press(self, by: str, press: str) -> bool:
        """Remember this person's press; return whether it is the first time that it comes."""
        if (by, press) in self._presses:
            return False
        self._presses[by, press] = None
        if len(self._presses) > MAX_STOPS:
            del self._presses[next(iter(self._presses))]
        return True

    def begin(self, stop: Stop) -> None:
        """Add the newest stop."""
        self.in_force[stop.id] = self.entry.stop = stop
        if len(self.in_force) > MAX_STOPS:
            del self.in_force[next(iter(self.in_force))]

    def end(self, stop_ids: Iterable[StopId]) -> None:
        """Remember that these stops ended."""
        for stop_id in stop_ids:
            self.in_force.pop(stop_id, None)
            self.ended[stop_id] = None
        # By when they began: what another cell still knows of long ago must not take the place of what ended here last.
        for stop_id in sorted(self.ended)[:-MAX_STOPS]:
            del self.ended[stop_id]
        self.entry.stop = next(reversed(self.in_force.values()), None)
        self.entry.ended = tuple(self.ended)

    def close(self) -> None:
        """Cancel the timer."""
        if self.repeat_timer is not None:
            self.repeat_timer.cancel()
            self.repeat_timer = None

"""Operators' live connections, so that a lost link or an ended right ends them at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from robotether_server.relay import endings
from robotether_server.relay.endings import Ending
from robotether_server.relay.sessions import Change
from robotether_server.store.fleet import Level, Robot, Snapshot

Use = Literal["observe", "drive", "video"]

DRIVING_LEVELS: frozenset[Level] = frozenset({"drive", "manage"})


@dataclass(eq=False, frozen=True)
class Connection:
    """One live connection of a user to a robot."""

    user_id: int
    user: str
    robot: Robot
    use: Use
    end: Callable[[Ending], None]

    def holds_in(self, snapshot: Snapshot) -> bool:
        """Tell whether the user may still do this with this robot."""
        robot = snapshot.robots.get(self.robot.id)
        if robot is None or robot.state != "active" or robot.name != self.robot.name:
            return False
        return permits(snapshot.level(self.user_id, robot.id), self.use)


def permits(level: Level | None, use: Use) -> bool:
    """Tell whether a grant of this level is enough."""
    return level in DRIVING_LEVELS if use == "drive" else level is not None


class Connections:
    """All live connections, by robot."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[int], None]] = []
        self._by_robot: dict[int, set[Connection]] = {}

    def listen(self, listener: Callable[[int], None]) -> None:
        """Tell this of each robot whose drivers or observers change."""
        self._listeners.append(listener)

    @contextmanager
    def joined(self, connection: Connection) -> Iterator[None]:
        """Count the connection as live inside the block."""
        robot_id = connection.robot.id
        members = self._by_robot.setdefault(robot_id, set())
        members.add(connection)
        self._changed(robot_id)
        try:
            yield
        finally:
            members.discard(connection)
            if not members:
                self._by_robot.pop(robot_id, None)
            self._changed(robot_id)

    def drivers(self, robot_id: int) -> list[str]:
        """Names of the users that drive the robot."""
        members = self._by_robot.get(robot_id, ())
        return sorted({member.user for member in members if member.use == "drive"})

    def observers(self, robot_id: int) -> int:
        """How many connections observe the robot."""
        return sum(member.use == "observe" for member in self._by_robot.get(robot_id, ()))

    def count(self, use: Use) -> int:
        """How many connections of this use there are in all."""
        return sum(member.use == use for members in self._by_robot.values() for member in members)

    def robot(self, change: Change) -> None:
        """Something happened to a robot; with its tunnel end the connections through it."""
        if change.what == "left":
            for member in list(self._by_robot.get(change.robot_id, ())):
                member.end(endings.link_lost(member.robot.name))

    def end_unrighted(self, snapshot: Snapshot) -> None:
        """End the connections that the newest rights do not permit."""
        for member in self._all():
            if not member.holds_in(snapshot):
                member.end(endings.rights_ended(member.robot.name))

    def end_all(self, ending: Ending) -> None:
        """End every connection."""
        for member in self._all():
            member.end(ending)

    def _changed(self, robot_id: int) -> None:
        for listener in self._listeners:
            listener(robot_id)

    def _all(self) -> list[Connection]:
        return [member for members in self._by_robot.values() for member in members]

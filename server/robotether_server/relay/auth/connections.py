"""Operators' live connections, which a lost link or an ended right ends at once.

The handlers join what they open, and ask before whether there is room: each connection costs
memory of the relay, and of the robot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.db.grants import includes
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.robots.sessions import Change
from robotether_server.schemas import Level

Use = Literal["observe", "drive", "video"]

# Video is something to see.
NEEDED: Mapping[Use, Level] = {"observe": "observe", "drive": "drive", "video": "observe"}


@dataclass(frozen=True)
class Caps:
    """How many connections may be open; rosbridge, video and events count each for itself."""

    per_user: int = 32
    # Of each use: observers and viewers must not keep a driver out.
    per_robot: int = 64
    # A robot shows 8 at once; the others are left to those who may drive it.
    cameras_of_observers: int = 4


@dataclass(eq=False)
class Connection:
    """One live connection of a user to a robot; it counts once it has reached the robot."""

    user_id: int
    user: str
    robot: RelayRobot
    use: Use
    end: Callable[[CloseReason], None]
    connected: bool = False
    level: Level = "observe"
    # Of a viewer: what it views, and whether it could drive.
    camera: str = ""
    may_drive: bool = False

    def holds_in(self, snapshot: Snapshot) -> bool:
        """Return whether the user may still do this with this robot."""
        robot = snapshot.robots.get(self.robot.id)
        if robot is None or robot.state != "active" or robot.name != self.robot.name:
            return False
        level = snapshot.level(self.user_id, robot.id)
        if level is None or not permits(level, self.use) or not includes(level, self.level):
            return False
        # What it may send was fixed when it was opened.
        return self.use == "video" or _rules_of(robot) == _rules_of(self.robot)


def permits(level: Level | None, use: Use) -> bool:
    """Return whether a grant of this level is enough."""
    return level is not None and includes(level, NEEDED[use])


class Connections:
    """All live connections, by robot."""

    def __init__(self, caps: Caps | None = None) -> None:
        self.caps = caps or Caps()
        self._listeners: list[Callable[[int], None]] = []
        self._of_user: Counter[tuple[int, bool]] = Counter()
        self._by_robot: dict[int, set[Connection]] = {}

    def listen(self, listener: Callable[[int], None]) -> None:
        """Notify this of each robot whose drivers or observers change."""
        self._listeners.append(listener)

    def no_room(self, connection: Connection) -> str | None:
        """Say why this connection may not be opened; None: it may."""
        mine, caps = self._of_user[_counted_as(connection)], self.caps
        if mine >= caps.per_user:
            return f"you already have {mine} connections open; close one first"
        members = self._by_robot.get(connection.robot.id, ())
        there = sum(member.use == connection.use for member in members)
        only_watches = connection.use == "video" and not connection.may_drive
        if there >= caps.per_robot - (caps.per_robot // 4 if only_watches else 0):
            return f"robot {connection.robot.name} already has {there} of them; try again later"
        if only_watches and self._too_many_cameras(connection):
            return (
                f"robot {connection.robot.name} already shows {caps.cameras_of_observers} cameras to "
                "those who only watch; close one first"
            )
        return None

    def _too_many_cameras(self, connection: Connection) -> bool:
        members = self._by_robot.get(connection.robot.id, ())
        watched = {member.camera for member in members if not member.may_drive}
        return len((watched | {connection.camera}) - {""}) > self.caps.cameras_of_observers

    @contextmanager
    def joined(self, connection: Connection) -> Iterator[None]:
        """Have the connection ended, inside the block, when its link or right is gone."""
        robot_id = connection.robot.id
        members = self._by_robot.setdefault(robot_id, set())
        members.add(connection)
        counted_as = _counted_as(connection)
        self._of_user[counted_as] += 1
        try:
            yield
        finally:
            members.discard(connection)
            self._of_user[counted_as] -= 1
            if not self._of_user[counted_as]:
                del self._of_user[counted_as]
            if not members and self._by_robot.get(robot_id) is members:
                del self._by_robot[robot_id]
            if connection.connected:
                self._changed(robot_id)

    def connected(self, connection: Connection) -> None:
        """Count the connection from now on: pages that wait for a robot drive nothing."""
        connection.connected = True
        self._changed(connection.robot.id)

    def observers(self, robot_id: int) -> int:
        """How many connections observe the robot."""
        return len(self._counted(robot_id, "observe"))

    def count(self, use: Use) -> int:
        """How many connections of this use there are in all."""
        return sum(len(self._counted(robot_id, use)) for robot_id in self._by_robot)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot; with its tunnel end the connections through it."""
        if change.what == "disconnected":
            for member in list(self._by_robot.get(change.robot_id, ())):
                member.end(close_reasons.link_lost(member.robot.name))

    def end_unrighted(self, snapshot: Snapshot) -> None:
        """End the connections that the newest rights do not permit."""
        for member in self._all():
            if not member.holds_in(snapshot):
                member.end(close_reasons.rights_ended(member.robot.name))

    def end_all(self, close_reason: CloseReason) -> None:
        """End every connection."""
        for member in self._all():
            member.end(close_reason)

    def _counted(self, robot_id: int, use: Use) -> list[Connection]:
        members = self._by_robot.get(robot_id, ())
        return [member for member in members if member.connected and member.use == use]

    def _changed(self, robot_id: int) -> None:
        for listener in self._listeners:
            listener(robot_id)

    def _all(self) -> list[Connection]:
        return [member for members in self._by_robot.values() for member in members]


def _rules_of(robot: RelayRobot) -> tuple[object, ...]:
    guard = robot.settings.guard
    return robot.settings.policy, guard.drive_topics, guard.max_age_ms


def _counted_as(connection: Connection) -> tuple[int, bool]:
    return connection.user_id, connection.use == "video"

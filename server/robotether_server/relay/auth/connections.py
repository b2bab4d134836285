"""Operators' live connections, which a lost link or an ended right ends at once.

The handlers join what they open, and ask before whether there is room: each connection costs
memory of the relay, and of the robot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from robotether_server.db.fleet import Snapshot
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.robots.connection import Connection, Use
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change


@dataclass(frozen=True)
class Caps:
    """How many connections may be open; rosbridge, video and events count each for itself."""

    per_user: int = 32
    # Of each use: observers and viewers must not keep a driver out.
    per_robot: int = 64
    # A robot shows 8 at once; the others are left to those who may drive it.
    cameras_of_observers: int = 4


class Connections:
    """All live connections, by robot."""

    def __init__(self, registry: SessionRegistry) -> None:
        self._registry = registry
        self.caps = Caps()
        self._listeners: list[Callable[[int], None]] = []
        self._of_user: Counter[tuple[int, bool, bool]] = Counter()

    def listen(self, listener: Callable[[int], None]) -> None:
        """Notify this of each robot whose drivers or observers change."""
        self._listeners.append(listener)

    def no_room(self, connection: Connection) -> str | None:
        """Say why this connection may not be opened; None: it may."""
        if connection.is_recorder:
            return None
        count, caps = self._of_user[_counted_as(connection)], self.caps
        # A user's routes have a limit of their own, where they are made.
        if count >= caps.per_user and not connection.is_route:
            return f"you already have {count} connections open; close one first"
        members = self._registry.robot(connection.robot.id).connections
        there = sum(member.use == connection.use and not member.is_recorder for member in members)
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
        members = self._registry.robot(connection.robot.id).connections
        watched = {
            member.camera for member in members if not member.may_drive and not member.is_recorder
        }
        return len((watched | {connection.camera}) - {""}) > self.caps.cameras_of_observers

    @contextmanager
    def joined(self, connection: Connection) -> Iterator[None]:
        """Have the connection ended, inside the block, when its link or right is gone."""
        robot_id = connection.robot.id
        members = self._registry.ensure_robot(robot_id).connections
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
            if connection.connected:
                self._changed(robot_id)

    def connected(self, connection: Connection) -> None:
        """Count the connection from now on: pages that wait for a robot drive nothing."""
        connection.connected = True
        self._changed(connection.robot.id)

    def observers(self, robot_id: int) -> int:
        """How many people observe the robot, without those who drive it: a page may have two connections."""
        drivers = self._counted(robot_id, "drive")
        driving = {member.user_id for member in drivers if not member.is_route}
        return len({member.user_id for member in self._counted(robot_id, "observe")} - driving)

    def count(self, use: Use) -> int:
        """How many connections of this use there are in all."""
        return sum(len(self._counted(robot.id, use)) for robot in self._registry.robots())

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot; with its tunnel end the connections through it."""
        if change.what == "disconnected":
            for member in list(self._registry.robot(change.robot_id).connections):
                member.end(close_reasons.link_lost(member.robot.name))

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """End the connections that the newest rights do not permit."""
        for member in self._all():
            if not member.holds_in(snapshot):
                member.end(close_reasons.rights_ended(member.robot.name))

    def end_all(self, close_reason: CloseReason) -> None:
        """End every connection."""
        for member in self._all():
            member.end(close_reason)

    def _counted(self, robot_id: int, use: Use) -> list[Connection]:
        members = self._registry.robot(robot_id).connections
        return [
            member
            for member in members
            if member.connected and member.use == use and not member.is_recorder
        ]

    def _changed(self, robot_id: int) -> None:
        for listener in self._listeners:
            listener(robot_id)

    def _all(self) -> list[Connection]:
        return [member for robot in self._registry.robots() for member in robot.connections]


def _counted_as(connection: Connection) -> tuple[int, bool, bool]:
    return connection.user_id, connection.use == "video", connection.is_route

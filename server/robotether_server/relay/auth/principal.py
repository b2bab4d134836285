"""What a user has set up and left to the relay: it has that user's rights, and nobody is at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.robots.connection import Connection


@dataclass(frozen=True)
class Principal:
    """A user's routes into one robot."""

    user_id: int
    user_name: str

    @property
    def name(self) -> str:
        """What people read as the driver; no user can have such a name."""
        return f"{self.user_name} (route)"

    def connection(self, robot: RelayRobot, end: Callable[[CloseReason], None]) -> Connection:
        """Return a driver's connection of this principal; making a route needs the level manage."""
        return Connection(
            self.user_id, self.name, robot, "drive", end, level="manage", is_route=True
        )

"""What the other cells report: which robots they have, and who stopped robots.

`dialer` feeds it. A cell counts as long as it is connected; then what it reported is forgotten, and its robots
count as offline. Its stops stay. A robot belongs to the cell with its newest session (the highest epoch), and an older
session here ends.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from msgspec.structs import replace

from robotether_server.contract.control import StopObject
from robotether_server.contract.robots import LiveState
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.cells.messages import (
    PeerApp,
    PeerApps,
    PeerHello,
    PeerMessage,
    PeerRobot,
    PeerStop,
    PeerStopEnd,
)
from robotether_server.relay.control.stops import Stops
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change

log = logging.getLogger(__name__)


@dataclass(eq=False)
class Peer:
    """A cell that is connected. `address` is its peer listener, an IP address with its port."""

    name: str
    address: str
    robots: dict[int, PeerRobot] = field(default_factory=dict)
    # By user's id and name.
    apps: dict[tuple[int, str], PeerApp] = field(default_factory=dict)


class Peers:
    """The cells that are connected, with the robots that each has."""

    def __init__(self, registry: SessionRegistry, stops: Stops, cells: Cells) -> None:
        self._registry = registry
        self._stops = stops
        self._cells = cells
        self._listeners: list[Callable[[int], None]] = []
        self._connected: dict[str, Peer] = {}

    def listen(self, listener: Callable[[int], None]) -> None:
        """Notify this of each robot of another cell that changes."""
        self._listeners.append(listener)

    def count(self) -> int:
        """How many cells are connected."""
        return len(self._connected)

    def find(self, name: str) -> Peer | None:
        """Return a cell that is connected, by its name."""
        return self._connected.get(name)

    def all(self) -> list[Peer]:
        """Return the cells that are connected."""
        return list(self._connected.values())

    def addresses(self) -> list[str]:
        """Where the cells that are connected have their peer listeners."""
        return [peer.address for peer in self._connected.values()]

    def here_for_s(self, robot_id: int) -> float | None:
        """Return for how long a robot has been here that may have been at another cell before; None: it was not.

        Less than that while a clock is ahead elsewhere: a ticket of there, used there, is older than it says.
        """
        connected_at = self._registry.presence(robot_id).connected_at
        if connected_at is None or not self._cells.peers():
            return None
        return time.monotonic() - connected_at - self._cells.clocks_ahead_s()

    def robot_count(self) -> int:
        """How many robots they have."""
        return sum(len(peer.robots) for peer in self._connected.values())

    def connected(self, name: str, address: str) -> Peer:
        """A cell is connected."""
        log.info("cell %s is connected at %s", name, address)
        peer = self._connected[name] = Peer(name, address)
        return peer

    def disconnected(self, peer: Peer) -> None:
        """A cell is gone, as far as this one knows."""
        log.warning("cell %s is gone, with %d robots", peer.name, len(peer.robots))
        if self._connected.get(peer.name) is peer:
            del self._connected[peer.name]
        for robot_id in peer.robots:
            self._on_offline(robot_id)

    def on_message(self, peer: Peer, message: PeerMessage) -> None:
        """A cell reported something."""
        match message:
            case PeerRobot(robot_id, online=True):
                peer.robots[robot_id] = message
                self._end_older_session(robot_id)
                self._changed(robot_id)
                if self._is_confirmed(robot_id):
                    self._stops.on_confirmed(robot_id)
            case PeerRobot(robot_id):
                if peer.robots.pop(robot_id, None) is not None:
                    self._on_offline(robot_id)
            case PeerStop():
                self._stops.learn(message.stop)
            case PeerStopEnd(robot_id):
                self._stops.learn_end(robot_id, message.stop_id)
            case PeerApps():
                peer.apps = {(app.user_id, app.name): app for app in message.apps}
            case PeerHello():
                pass

    def owner(self, robot_id: int) -> Peer | None:
        """Return the cell that has the robot, None when it is this one, or none."""
        having = (peer for peer in self._connected.values() if robot_id in peer.robots)
        peer = max(having, key=lambda peer: peer.robots[robot_id].epoch, default=None)
        presence = self._registry.presence(robot_id)
        if peer is None or (presence.online and presence.epoch >= peer.robots[robot_id].epoch):
            return None
        return peer

    def owner_of_app(self, user_id: int, name: str) -> tuple[Peer, PeerApp] | None:
        """Return an app of a user that is connected to another cell, with the first that has it."""
        for peer in self._connected.values():
            if (app := peer.apps.get((user_id, name))) is not None:
                return peer, app
        return None

    def described(self, robot_id: int) -> LiveState | None:
        """Return what the robot's cell reports of it; None: no other cell has the robot."""
        if (peer := self.owner(robot_id)) is None:
            return None
        live, stop = peer.robots[robot_id].object, self._stops.shown(robot_id)
        if stop is None or live.control.stopped is not None:
            return live
        # A robot is stopped when any cell says so; that one does not know yet.
        stopped = StopObject(stop.by, stop.at, confirmed=False)
        return replace(live, control=replace(live.control, stopped=stopped))

    def confirmation(self, robot_id: int) -> Awaitable[bool] | None:
        """Wait shortly until the guard of a robot at another cell has its stop; None: no other cell has the robot."""
        return None if self.owner(robot_id) is None else self._confirmation(robot_id)

    async def _confirmation(self, robot_id: int) -> bool:
        return self._is_confirmed(robot_id) or await self._stops.reported_confirmation(robot_id)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot here; its epoch is known once its agent has said hello."""
        if change.what == "updated":
            # The others hear of this change before they hear of the end.
            asyncio.get_running_loop().call_soon(self._end_older_session, change.robot_id)

    def _changed(self, robot_id: int) -> None:
        for listener in self._listeners:
            listener(robot_id)

    def _is_confirmed(self, robot_id: int) -> bool:
        live = self.described(robot_id)
        stopped = None if live is None else live.control.stopped
        return stopped is not None and stopped.confirmed

    def _end_older_session(self, robot_id: int) -> None:
        presence, peer = self._registry.presence(robot_id), self.owner(robot_id)
        # Without an epoch nobody knows which is the older; the connection of that one times out.
        if presence.online and presence.epoch and peer is not None:
            self._registry.end_links(
                robot_id, "superseded", f"a newer session of this robot is at cell {peer.name}"
            )

    def _on_offline(self, robot_id: int) -> None:
        if self.owner(robot_id) is None:
            self._registry.seen_elsewhere(robot_id)
        self._changed(robot_id)

"""Answers /cell/v1/fleet: tells another cell which robots this one has, and who stopped robots.

`app` runs one handler a cell. Like a client of the live fleet it remembers which robots changed and not how, so it is
never larger than the fleet. Stops go first. What a cell learned of stops it passes on, so that two that cannot reach
each other share them through a third.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice

from aiohttp import ClientWebSocketResponse, WSMsgType, web

from robotether_server.contract.robots import LiveState
from robotether_server.problems import HttpError
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.cells.messages import (
    PeerApp,
    PeerApps,
    PeerHello,
    PeerMessage,
    PeerRobot,
    PeerStop,
    PeerStopEnd,
    build,
)
from robotether_server.relay.control.fleet_events import ChangedRobots, FleetEvents
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot_stops import RobotStops
from robotether_server.tasks import end_tasks

FLEET_PATH = "/cell/v1/fleet"
PING_EVERY_S = 1.0
SILENT_AFTER_S = 3.0
ROBOTS_AT_ONCE = 20
StopState = tuple[tuple[object, ...], tuple[object, ...]]
NO_STOPS: StopState = ((), ())


class PeerFeed(ChangedRobots):
    """What one other cell has yet to receive."""

    def __init__(
        self,
        fleet_events: FleetEvents,
        registry: SessionRegistry,
        list_apps: Callable[[], list[PeerApp]],
    ) -> None:
        super().__init__()
        self._fleet_events = fleet_events
        self._registry = registry
        self._list_apps = list_apps
        self._sent_apps: list[PeerApp] = []
        self._sent: dict[int, PeerRobot] = {}
        self._sent_stops: dict[int, StopState] = {}
        self.mark_all()

    def mark_all(self) -> None:
        """Remember that anything may have changed."""
        self.add(*(robot.id for robot in self._registry.robots()), *self._sent)

    def stops_of(self, robot_id: int) -> Iterator[PeerMessage]:
        """The robot's stops, if they changed since they were sent."""
        stops = self._registry.robot(robot_id).stops
        state: StopState = (tuple(stops.in_force), tuple(stops.ended))
        if state != self._sent_stops.get(robot_id, NO_STOPS):
            self._sent_stops[robot_id] = state
            yield from _stop_messages(robot_id, stops)

    def newest(self, robot_id: int) -> Iterator[PeerMessage]:
        """The robot's newest state, if it is another than the one that was sent."""
        presence, last = self._registry.presence(robot_id), self._sent.get(robot_id)
        if not presence.online:
            if last is not None:
                del self._sent[robot_id]
                yield PeerRobot(robot_id, last.epoch, online=False, object=LiveState())
            return
        state = self._fleet_events.describe_here(robot_id)
        robot = PeerRobot(robot_id, presence.epoch, online=True, object=state)
        if robot != last:
            self._sent[robot_id] = robot
            yield robot

    def newest_apps(self) -> Iterator[PeerMessage]:
        """The apps that are connected here, if they changed since they were sent."""
        if (apps := self._list_apps()) != self._sent_apps:
            self._sent_apps = apps
            yield PeerApps(apps)


class PeerFeedHandler:
    """Answers /cell/v1/fleet."""

    def __init__(
        self,
        cells: Cells,
        fleet_events: FleetEvents,
        registry: SessionRegistry,
        list_apps: Callable[[], list[PeerApp]],
    ) -> None:
        self._cells = cells
        self._fleet_events = fleet_events
        self._registry = registry
        self._following: Counter[str] = Counter()
        # Lists the apps that are connected here.
        self._list_apps = list_apps

    def unreached(self) -> list[str]:
        """Name the other cells that do not follow this one, to which its robots are offline."""
        return [cell.name for cell in self._cells.peers() if not self.is_followed_by(cell.name)]

    def is_followed_by(self, cell: str) -> bool:
        """Return whether a cell is connected, and so learns of a stop at once."""
        return self._following[cell] > 0

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Send all that is, then each change, until the other cell is gone."""
        connection = web.WebSocketResponse(autoping=False, compress=False, timeout=PING_EVERY_S)
        if not connection.can_prepare(request):
            raise HttpError(426, "cannot follow the fleet: connect with a WebSocket")
        await connection.prepare(request)
        feed = PeerFeed(self._fleet_events, self._registry, self._list_apps)
        with self._fleet_events.followed(feed), self._counted(request.query.get("cell", "")):
            tasks = [
                asyncio.create_task(_listen(connection, feed)),
                asyncio.create_task(_ping(connection)),
            ]
            try:
                await self._send(connection, feed)
            except (TimeoutError, ConnectionError):
                if request.transport is not None:
                    request.transport.abort()
            finally:
                await end_tasks(tasks)
        return connection

    @contextmanager
    def _counted(self, cell: str) -> Iterator[None]:
        self._following[cell] += 1
        try:
            yield
        finally:
            self._following[cell] -= 1

    async def _send(self, connection: web.WebSocketResponse, feed: PeerFeed) -> None:
        await _write(connection, PeerHello(self._cells.name))
        while not feed.ended:
            await _send_changes(connection, feed)
            await feed.wait(PING_EVERY_S)
        await connection.close()


async def receive(connection: ClientWebSocketResponse | web.WebSocketResponse) -> str | None:
    """Return the next text, and answer pings; None: the connection is over, or silent for too long."""
    while True:
        try:
            message = await connection.receive(SILENT_AFTER_S)
        except TimeoutError:
            return None
        if message.type is WSMsgType.TEXT:
            return str(message.data)
        if message.type is WSMsgType.PING:
            await connection.pong(message.data)
        elif message.type is not WSMsgType.PONG:
            return None


async def _listen(connection: web.WebSocketResponse, feed: PeerFeed) -> None:
    """End the feed when the other cell is gone; it sends pongs only."""
    try:
        while await receive(connection) is not None:
            pass
    finally:
        feed.end()


async def _ping(connection: web.WebSocketResponse) -> None:
    """Ask for signs of life, also while a whole fleet is on its way."""
    while True:
        await connection.ping()
        await asyncio.sleep(PING_EVERY_S)


async def _send_changes(connection: web.WebSocketResponse, feed: PeerFeed) -> None:
    for message in feed.newest_apps():
        await _write(connection, message)
    waiting: dict[int, None] = {}
    while (robot_ids := feed.pop()) or waiting:
        for robot_id in robot_ids:
            for message in feed.stops_of(robot_id):
                await _write(connection, message)
        waiting.update(dict.fromkeys(robot_ids))
        for robot_id in list(islice(waiting, ROBOTS_AT_ONCE)):
            del waiting[robot_id]
            for message in feed.newest(robot_id):
                await _write(connection, message)
        # A whole fleet must hold up neither drivers, nor a stop that comes meanwhile.
        await asyncio.sleep(0)


async def _write(connection: web.WebSocketResponse, message: PeerMessage) -> None:
    async with asyncio.timeout(SILENT_AFTER_S):
        await connection.send_str(build(message))


def _stop_messages(robot_id: int, stops: RobotStops) -> Iterator[PeerMessage]:
    for at, by in stops.ended:
        yield PeerStopEnd(robot_id, at, by)
    for stop in stops.in_force.values():
        yield PeerStop(robot_id, stop.at, stop.by, stop.reason)

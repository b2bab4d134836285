"""Answers /recorder, for the stack's own recorder alone: what the relay knows of robots that it follows.

The recorder names the robots, and whether it writes; the relay sends drive commands, round trips, ages and control as
JSON, each as a text. `app` offers the path inside the stack only, where nginx leads nobody, and it takes a ticket that
web signs for nobody. What robots send the recorder gets as any observer does. It must never make anybody wait: a
recorder that does not read loses what is the oldest, and its number is sent.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import msgspec
from aiohttp import WSMsgType, web
from msgspec import Struct
from msgspec.structs import asdict

from robotether_server.db.fleet import Snapshot
from robotether_server.problems import HttpError
from robotether_server.relay.auth.access import Access
from robotether_server.relay.control.fleet_events import ChangedRobots, FleetEvents
from robotether_server.relay.robots.recorders import RecordedTopic, RecorderOfRobot, stamped
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change
from robotether_server.tasks import end_tasks

log = logging.getLogger(__name__)

PATH = "/recorder"
# Maximum number of events that wait for a recorder, some seconds of a fleet's.
MAX_WAITING = 10_000
MAX_TEXT_BYTES = 4096
HEARTBEAT_S = 10.0


class FollowRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """Which robot the recorder follows from now on, and whether it writes; `follows` false: no longer."""

    robot_id: int
    follows: bool
    writes: bool = False


class RecorderConnection(ChangedRobots):
    """One recorder: the robots that it follows, and what it has yet to get."""

    def __init__(
        self, registry: SessionRegistry, fleet: FleetEvents, drive_topic: Callable[[int], str]
    ) -> None:
        super().__init__()
        self._registry = registry
        self._fleet = fleet
        self._drive_topic = drive_topic
        self._followed: dict[int, RecorderOfRobot] = {}
        self._waiting: deque[bytes] = deque(maxlen=MAX_WAITING)
        self._lost = 0

    def follow(self, request: FollowRequest) -> None:
        """Follow a robot, or no longer."""
        robot_id = request.robot_id
        recorders = self._registry.ensure_robot(robot_id).recorders
        did_write = recorders.write
        if request.follows:
            recorder = self._followed.get(robot_id)
            if recorder is None:
                recorder = RecorderOfRobot(partial(self._send, robot_id))
                self._followed[robot_id] = recorder
                recorders.add(recorder)
            recorder.writes = request.writes
            self.mark(robot_id)
        elif (recorder := self._followed.pop(robot_id, None)) is not None:
            recorders.remove(recorder)
        if recorders.write != did_write:
            self._fleet.changed(robot_id)

    def leave(self) -> None:
        """Follow no robot any longer."""
        for robot_id in list(self._followed):
            self.follow(FollowRequest(robot_id, follows=False))

    def mark(self, robot_id: int) -> None:
        """A robot changed."""
        if robot_id in self._followed:
            self.add(robot_id)

    def mark_all(self) -> None:
        """Anything may have changed."""
        self.add(*self._followed)

    def on_robot_change(self, change: Change) -> None:
        """A robot's guard reported what its driver saw."""
        report = change.seen
        if change.robot_id not in self._followed or report is None:
            return
        self._send(change.robot_id, "seen_ages", stamped(asdict(report)))

    async def next_texts(self, timeout_s: float) -> list[bytes]:
        """Wait until something is to be sent, at most `timeout_s`, and take it."""
        await self.wait(timeout_s)
        for robot_id in self._followed.keys() & self.pop():
            self._send_control(robot_id)
        texts = list(self._waiting)
        self._waiting.clear()
        if self._lost:
            texts.insert(0, _text(lost=self._lost))
            self._lost = 0
            # Of what is so now the newest may be among them.
            self.mark_all()
        return texts

    def _send_control(self, robot_id: int) -> None:
        live = self._fleet.describe_here(robot_id)
        control = live.control
        driver, stop = control.driver, control.stopped
        members = {
            "online": live.online,
            "driver": "" if driver is None else driver.user,
            "fence": 0 if driver is None else driver.fence,
            "stopped": stop is not None,
            "stopped_by": "" if stop is None else stop.by,
            "stop_confirmed": stop is not None and stop.confirmed,
            "guard": control.guard,
            # No members of the file's message. The topic says which others of the ROS graph are the robot's.
            "drive_topic": self._drive_topic(robot_id),
            "elsewhere": self._fleet.is_elsewhere(robot_id),
        }
        self._send(robot_id, "control", stamped(members))

    def _send(self, robot_id: int, topic: RecordedTopic, message: Mapping[str, Any]) -> None:
        if len(self._waiting) == MAX_WAITING:
            self._lost += 1
        self._waiting.append(_text(robot_id=robot_id, topic=topic, message=message))
        self._wake.set()


class RecorderHandler:
    """Answers /recorder."""

    def __init__(
        self,
        access: Access,
        registry: SessionRegistry,
        fleet: FleetEvents,
        snapshot: Callable[[], Snapshot],
    ) -> None:
        self._access = access
        self._registry = registry
        self._fleet = fleet
        self._snapshot = snapshot
        self._connections: set[RecorderConnection] = set()

    def count(self) -> int:
        """How many recorders are connected."""
        return len(self._connections)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot."""
        for connection in self._connections:
            connection.on_robot_change(change)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Send a recorder what happens to the robots that it follows, until it is gone."""
        self._access.check_recorder(request.query.get("ticket"))
        socket = web.WebSocketResponse(
            max_msg_size=MAX_TEXT_BYTES, heartbeat=HEARTBEAT_S, compress=False
        )
        if not socket.can_prepare(request):
            raise HttpError(426, "cannot open the recorder's channel: connect with a WebSocket")
        await socket.prepare(request)
        connection = RecorderConnection(self._registry, self._fleet, self._drive_topic)
        self._connections.add(connection)
        log.info("the recorder is connected")
        try:
            with self._fleet.followed(connection):
                sending = asyncio.create_task(_send(socket, connection))
                try:
                    await self._read(socket, connection)
                finally:
                    await end_tasks([sending])
        finally:
            self._connections.discard(connection)
            connection.leave()
            log.info("the recorder is gone")
        return socket

    def _drive_topic(self, robot_id: int) -> str:
        robot = self._snapshot().robots.get(robot_id)
        return "" if robot is None else robot.settings.drive_topic

    async def _read(self, socket: web.WebSocketResponse, connection: RecorderConnection) -> None:
        async for message in socket:
            if message.type is not WSMsgType.TEXT:
                return
            try:
                request = msgspec.json.decode(message.data, type=FollowRequest)
            except msgspec.DecodeError:
                return
            # What is not there would stay in the registry for ever.
            if not request.follows or request.robot_id in self._snapshot().robots:
                connection.follow(request)


async def _send(socket: web.WebSocketResponse, connection: RecorderConnection) -> None:
    while not connection.ended:
        for text in await connection.next_texts(HEARTBEAT_S):
            await socket.send_str(text.decode())
    await socket.close()


def _text(**members: Any) -> bytes:
    return msgspec.json.encode(members)

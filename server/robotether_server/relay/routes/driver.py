"""Publishes what a user's routes bring to one robot, as the driver of that robot.

`routes` makes one for all routes of a user into a robot, and an `OperatorSession` runs it: lease, guard, records and
ends are those of any driver. What goes to the robot is what its `MessageValidator` has written again, inside its policy
and limits. A drive command has the age that its source's connection bounds, and is dropped as any old command is.

A route between robots holds the lease as long as both are there. Routes of apps alone begin it with the first message
that may go to the robot, and end it after a silence, so that a page that nobody uses keeps nobody away.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress

from aiohttp import WSMsgType
from robotether_common.guard import STAMP

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.channels.rosbridge.bridge import (
    RobotEnd,
    Traffic,
    close_reason_of_gone_robot,
    until_robot_gone,
)
from robotether_server.relay.channels.rosbridge.drive_path import (
    CommandTimestamps,
    DriveCommand,
    DrivePath,
)
from robotether_server.relay.channels.rosbridge.message_validator import (
    MessageRefusedError,
    MessageValidator,
    ValidatedMessage,
)
from robotether_server.relay.channels.rosbridge.operations import (
    NotJsonError,
    read_json,
    write_json,
)
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.sockets import OperatorConnection, RobotSocket, why_closed
from robotether_server.relay.robots.session_messages import SeenReport
from robotether_server.relay.routes.source import (
    LOOK_EVERY_S,
    RouteSource,
    SourceMessage,
    words_of_error,
)
from robotether_server.tasks import wait_for_event

# Maximum size of an answer of a robot that is read; nothing but a complaint is of use here.
MAX_ANSWER_BYTES = 4096
# Time without a command after which the next of an app must say to stand still, as for a page's driver: a page that
# was frozen or cut off goes on by itself, and maybe nobody looks any more.
HELD_AFTER_S = 2.0
# Time without a message to the robot after which routes of apps alone give it back.
SILENT_AFTER_S = 10.0
LOOK_AT_SILENCE_EVERY_S = 1.0


class RouteDriver(OperatorConnection):
    """Implements `handler.DriverEnd`."""

    def __init__(self, robot: RelayRobot, traffic: Traffic) -> None:
        super().__init__(robot.name)
        self._traffic = traffic
        policy = robot.settings.policy
        self._validator = MessageValidator(
            policy.of("manage"), robot.settings.guard.drive_topics, policy.limits
        )
        self._max_bytes = policy.limits.message_kb * 1024
        self._sources: dict[int, RouteSource] = {}
        self._due = asyncio.Event()
        self._drive: DrivePath | None = None
        self._robot: RobotSocket | None = None
        # Topics that no route has any more.
        self._given_up: set[str] = set()
        # By time.monotonic(): when a message went to the robot last.
        self._sent_s = 0.0
        self.refused: Counter[str] = Counter()
        # Whether no route has had a use for the robot yet.
        self.is_waiting = True
        # Of the app whose message began the lease; None: a robot's route did.
        self.address: str | None = None
        # Whether the robot has been reached, with the lease.
        self.is_connected = False

    @property
    def bytes_passed(self) -> int:
        """How many bytes of messages went to the robot."""
        return 0 if self._robot is None else self._robot.sent_bytes

    def wake(self) -> None:
        """A source has a message."""
        self._due.set()

    def end(self, close_reason: CloseReason) -> None:
        """End it at once, also while it waits."""
        super().end(close_reason)
        self.wake()

    def add(self, source: RouteSource) -> None:
        """Publish what this source brings from now on."""
        self._sources[source.route.id] = source
        self.wake()

    def remove(self, source: RouteSource) -> None:
        """Publish nothing of this source any more."""
        if self._sources.pop(source.route.id, None) is None:
            return
        topic = source.route.target_topic
        topics = {each.route.target_topic for each in self._sources.values()}
        if source.is_advertised and topic not in topics:
            self._given_up.add(topic)
            self.wake()

    def show_seen(self, report: SeenReport) -> None:
        """Nobody sees anything here: a route names no frames."""

    async def close_reason_of_gone(self) -> CloseReason:
        """Return why it ended when the relay stops."""
        return close_reasons.relay_stopping()

    async def wait(self) -> CloseReason | None:
        """Wait until a route has a use for the robot; return why it ended before."""
        while not self._ended.done():
            if any(map(self._begins, self._sources.values())):
                self.is_waiting = False
                return None
            await self._wait_until_due()
        return self._ended.result()

    def _begins(self, source: RouteSource) -> bool:
        """Return whether a route begins the lease: a robot's at once, an app's with a message that may go."""
        if source.route.source_app is None:
            return True
        now_s = time.monotonic()
        message = source.take(now_s) if source.due_in_s(now_s) == 0.0 else None
        checked = None if message is None else self._validate(source, message)
        if message is None or checked is None:
            return False
        if checked.drive is not None and self._is_held(source, checked.drive, now_s):
            return False
        # It goes once the robot is reached, or what has come after it.
        source.receive(message)
        source.moves_until_s, self.address = now_s + HELD_AFTER_S, source.address
        return True

    async def run(self, connect: Callable[[], Awaitable[RobotEnd]]) -> CloseReason:
        """Reach the robot and publish; return why that ended."""
        if self._ended.done():
            return self._ended.result()
        return await self._run_until_ended(self._work(connect))

    async def _work(self, connect: Callable[[], Awaitable[RobotEnd]]) -> CloseReason:
        robot_end = await connect()
        robot, lease = robot_end.socket, robot_end.lease
        self._robot = robot
        if lease is None:
            raise TypeError("a route drives with a lease")
        drive = self._drive = DrivePath(lease, robot, CommandTimestamps(time.monotonic()))
        self.is_connected, self._sent_s = True, time.monotonic()
        for source in self._app_sources():
            # What an app sent to a robot that was not there yet is no longer meant.
            source.forget_before(self._sent_s - HELD_AFTER_S)
        try:
            with robot_end.counted:
                return await self._run_together(
                    self._read(robot),
                    until_robot_gone(drive.run(), self.name),
                    until_robot_gone(self._publish_due(robot), self.name),
                    self._until_silent(),
                )
        finally:
            self.is_connected = False
            robot.drop()

    async def _until_silent(self) -> CloseReason:
        while True:
            left_s = self._sent_s + SILENT_AFTER_S - time.monotonic()
            if left_s <= 0 and len(self._app_sources()) == len(self._sources):
                return close_reasons.client_silent(self.name, SILENT_AFTER_S)
            await asyncio.sleep(max(left_s, LOOK_AT_SILENCE_EVERY_S))

    async def _publish_due(self, robot: RobotSocket) -> CloseReason:
        while True:
            await self._wait_until_due()
            await self._give_up(robot)
            for source in list(self._sources.values()):
                if self._is_due(robot, source):
                    await self._publish_newest(robot, source)

    async def _wait_until_due(self) -> None:
        """Wait until a message may be due, or something else changed."""
        now_s = time.monotonic()
        waits_s = [source.due_in_s(now_s) for source in self._sources.values()]
        due_s = min((each for each in waits_s if each is not None), default=None)
        await wait_for_event(self._due, None if due_s is None else max(due_s, LOOK_EVERY_S))

    def _is_due(self, robot: RobotSocket, source: RouteSource) -> bool:
        """Return whether a message may go now; the newest command waits in `DrivePath` while the connection is full."""
        has_room = source.is_drive or not robot.waiting_bytes()
        return has_room and source.due_in_s(time.monotonic()) == 0.0

    async def _give_up(self, robot: RobotSocket) -> None:
        while self._given_up:
            # What the policy no longer allows ends with the connection.
            with suppress(MessageRefusedError):
                fields = {"op": "unadvertise", "topic": self._given_up.pop()}
                await self._send_checked(robot, self._validator.check(write_json(fields)))

    async def _publish_newest(self, robot: RobotSocket, source: RouteSource) -> None:
        message = source.take(time.monotonic())
        checked = None if message is None else self._validate(source, message)
        if message is None or checked is None or self._drive is None:
            return
        if not source.is_advertised and not await self._advertise(robot, source):
            return
        self._drive.log.message()
        if checked.drive is None:
            await self._send_checked(robot, checked)
            self._on_sent(source)
        elif message.since_s is None:
            source.problem = "the age of its messages is not known yet"
        else:
            await self._submit(self._drive, source, checked.drive)

    def _validate(self, source: RouteSource, message: SourceMessage) -> ValidatedMessage | None:
        """Write a message for the robot; None: it may not go there, as the route says."""
        if len(message.data) > self._max_bytes:
            source.problem = f"the message has over {self._max_bytes >> 10} KB, the target's limit"
            return None
        content = source.content(message.data)
        if content is None:
            return None
        fields: dict[str, object] = {"op": "publish", **_name_of(source), "msg": content}
        if message.since_s is not None:
            fields[STAMP] = {"t_ms": message.since_s * 1000}
        return self._validate_fields(source, fields)

    def _validate_fields(
        self, source: RouteSource, fields: dict[str, object]
    ) -> ValidatedMessage | None:
        try:
            return self._validator.check(write_json(fields))
        except MessageRefusedError as refused:
            self.refused[refused.kind] += 1
            source.problem = refused.detail
            return None

    async def _advertise(self, robot: RobotSocket, source: RouteSource) -> bool:
        """Return whether the robot may be told of the topic, and is."""
        fields = {"op": "advertise", **_name_of(source), "type": source.route.type}
        if (checked := self._validate_fields(source, fields)) is None:
            return False
        await self._send_checked(robot, checked)
        source.is_advertised = True
        return True

    def _is_held(self, source: RouteSource, command: DriveCommand, now_s: float) -> bool:
        """Return whether a command of an app moves nothing, because none before it said to stand still."""
        if source.route.source_app is None or command.stands or now_s <= source.moves_until_s:
            return False
        source.problem = "the app must send a zero before it can move the robot"
        return True

    async def _submit(self, drive: DrivePath, source: RouteSource, command: DriveCommand) -> None:
        now_s = time.monotonic()
        if self._is_held(source, command, now_s):
            return
        source.moves_until_s = now_s + HELD_AFTER_S
        dropped = drive.log.entry.dropped_old
        complaint = await drive.submit(command)
        if drive.log.entry.dropped_old == dropped:
            self._on_sent(source)
        elif complaint is not None:
            source.problem = complaint

    def _on_sent(self, source: RouteSource) -> None:
        self._sent_s = time.monotonic()
        source.on_sent(self._sent_s)

    async def _send_checked(self, robot: RobotSocket, checked: ValidatedMessage) -> None:
        self._traffic.count_to_robot(len(checked.data))
        await robot.send_frame(checked.data, WSMsgType.TEXT)

    async def _read(self, robot: RobotSocket) -> CloseReason:
        while True:
            message = await robot.next_message()
            if message.type is WSMsgType.TEXT:
                self._on_answer(message.data)
            elif message.type is WSMsgType.CLOSE:
                return await close_reason_of_gone_robot(self.name, why_closed(message))
            elif message.type is not WSMsgType.BINARY:
                return await close_reason_of_gone_robot(self.name)

    def _on_answer(self, data: bytes) -> None:
        """Show a complaint of the robot's guard or rosbridge at the route that it concerns."""
        if len(data) > MAX_ANSWER_BYTES or b'"status"' not in data:
            return
        try:
            answer = read_json(data)
        except NotJsonError:
            return
        words = words_of_error(answer)
        for source in self._sources.values():
            if words and answer.get("id") == _name_of(source)["id"]:
                source.problem = words

    def _app_sources(self) -> list[RouteSource]:
        return [each for each in self._sources.values() if each.route.source_app is not None]


def _name_of(source: RouteSource) -> dict[str, object]:
    """Return the fields that name a route's messages, and the robot's answers to them."""
    return {"topic": source.route.target_topic, "id": f"route {source.route.id}"}

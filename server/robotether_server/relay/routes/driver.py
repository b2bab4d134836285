"""Publishes what a user's routes bring to one robot, as the driver of that robot.

`routes` makes one for all routes of a user into a robot, and an `OperatorSession` runs it: lease, guard, records and
ends are those of any driver. What goes to the robot is what its `MessageValidator` has written again, inside its policy
and limits. A drive command has the age that its source's connection bounds, and is dropped as any old command is.
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
from robotether_server.relay.channels.rosbridge.bridge import LINK_GRACE_S, RobotEnd, Traffic
from robotether_server.relay.channels.rosbridge.drive_path import CommandTimestamps, DrivePath
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
from robotether_server.relay.robots.robot import SeenReport
from robotether_server.relay.routes.source import (
    LOOK_EVERY_S,
    RouteSource,
    SourceMessage,
    words_of_error,
)

# Maximum size of an answer of a robot that is read; nothing but a complaint is of use here.
MAX_ANSWER_BYTES = 4096
# Time without a command after which the next of an app must say to stand still, as for a page's driver: a page that
# was frozen or cut off goes on by itself, and maybe nobody looks any more.
HELD_AFTER_S = 2.0


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
        self.refused: Counter[str] = Counter()
        # Whether the robot has been reached, with the lease.
        self.is_connected = False

    @property
    def bytes_passed(self) -> int:
        """How many bytes of messages went to the robot."""
        return 0 if self._robot is None else self._robot.sent_bytes

    def wake(self) -> None:
        """A source has a message."""
        self._due.set()

    def add(self, source: RouteSource) -> None:
        """Publish what this source brings from now on."""
        self._sources[source.route.id] = source
        self.wake()

    def remove(self, source: RouteSource) -> None:
        """Publish nothing of this source any more."""
        if self._sources.pop(source.route.id, None) is None:
            return
        topic = source.route.target_topic
        if source.is_advertised and topic not in self._topics():
            self._given_up.add(topic)
            self.wake()

    def show_seen(self, report: SeenReport) -> None:
        """Nobody sees anything here: a route names no frames."""

    async def close_reason_of_gone(self) -> CloseReason:
        """Return why it ended when the relay stops."""
        return close_reasons.relay_stopping()

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
        self.is_connected = True
        for source in self._sources.values():
            if source.route.source_app is not None:
                # What an app sent to a robot that was not there yet is no longer meant.
                source.forget()
        try:
            with robot_end.counted:
                return await self._run_together(
                    self._read(robot), self._or_robot_gone(drive.run()), self._publish_all(robot)
                )
        finally:
            self.is_connected = False
            robot.drop()

    async def _or_robot_gone(self, work: Awaitable[CloseReason]) -> CloseReason:
        try:
            return await work
        except ConnectionError:
            return await self._close_reason_by_robot("its connection broke")

    async def _publish_all(self, robot: RobotSocket) -> CloseReason:
        return await self._or_robot_gone(self._publish_due(robot))

    async def _publish_due(self, robot: RobotSocket) -> CloseReason:
        wait_s: float | None = None
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._due.wait()
            self._due.clear()
            await self._give_up(robot)
            for source in list(self._sources.values()):
                if self._is_due(robot, source):
                    await self._publish_newest(robot, source)
            now_s = time.monotonic()
            waits_s = [source.due_in_s(now_s) for source in self._sources.values()]
            due_s = min((each for each in waits_s if each is not None), default=None)
            wait_s = None if due_s is None else max(due_s, LOOK_EVERY_S)

    def _is_due(self, robot: RobotSocket, source: RouteSource) -> bool:
        """Return whether a message may go now; the newest command waits in `DrivePath` while the connection is full."""
        has_room = source.is_drive or not robot.waiting_bytes()
        return has_room and source.due_in_s(time.monotonic()) == 0.0

    async def _give_up(self, robot: RobotSocket) -> None:
        while self._given_up:
            # What the policy no longer allows ends with the connection.
            with suppress(MessageRefusedError):
                await self._send(robot, {"op": "unadvertise", "topic": self._given_up.pop()})

    async def _publish_newest(self, robot: RobotSocket, source: RouteSource) -> None:
        message = source.take(time.monotonic())
        if message is None:
            return
        if len(message.data) > self._max_bytes:
            source.problem = f"the message has over {self._max_bytes >> 10} KB, the target's limit"
            return
        try:
            await self._publish(robot, source, message)
        except MessageRefusedError as refused:
            self.refused[refused.kind] += 1
            source.problem = refused.detail

    async def _publish(
        self, robot: RobotSocket, source: RouteSource, message: SourceMessage
    ) -> None:
        content = source.content(message.data)
        if content is None or self._drive is None:
            return
        route = source.route
        name = {"topic": route.target_topic, "id": _id_of(source)}
        if not source.is_advertised:
            await self._send(robot, {"op": "advertise", **name, "type": route.type})
            source.is_advertised = True
        fields: dict[str, object] = {"op": "publish", **name, "msg": content}
        if message.since_s is not None:
            fields[STAMP] = {"t_ms": message.since_s * 1000}
        checked = self._validator.check(write_json(fields))
        self._drive.log.message()
        if checked.drive is None:
            await self._send_checked(robot, checked)
            source.on_sent(time.monotonic())
        elif message.since_s is None:
            source.problem = "the age of its messages is not known yet"
        else:
            await self._submit(self._drive, source, checked)

    async def _submit(
        self, drive: DrivePath, source: RouteSource, checked: ValidatedMessage
    ) -> None:
        if checked.drive is None:
            return
        now_s = time.monotonic()
        is_held = source.route.source_app is not None and now_s > source.moves_until_s
        if is_held and not checked.drive.stands:
            source.problem = "it moves nothing until a command of the app says to stand still"
            return
        source.moves_until_s = now_s + HELD_AFTER_S
        dropped = drive.log.entry.dropped_old
        complaint = await drive.submit(checked.drive)
        if drive.log.entry.dropped_old == dropped:
            source.on_sent(time.monotonic())
        elif complaint is not None:
            source.problem = complaint

    async def _send(self, robot: RobotSocket, fields: dict[str, object]) -> None:
        await self._send_checked(robot, self._validator.check(write_json(fields)))

    async def _send_checked(self, robot: RobotSocket, checked: ValidatedMessage) -> None:
        self._traffic.count_to_robot(len(checked.data))
        await robot.send_frame(checked.data, WSMsgType.TEXT)

    async def _read(self, robot: RobotSocket) -> CloseReason:
        while True:
            message = await robot.next_message()
            if message.type is WSMsgType.TEXT:
                self._on_answer(message.data)
            elif message.type is WSMsgType.CLOSE:
                return await self._close_reason_by_robot(why_closed(message))
            elif message.type is not WSMsgType.BINARY:
                return await self._close_reason_by_robot("its connection broke")

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
            if words and answer.get("id") == _id_of(source):
                source.problem = words

    async def _close_reason_by_robot(self, why: str) -> CloseReason:
        # A lost link, lease or stop ends the connection itself meanwhile, which says more.
        await asyncio.sleep(LINK_GRACE_S)
        return close_reasons.rosbridge_down(self.name, why)

    def _topics(self) -> set[str]:
        return {source.route.target_topic for source in self._sources.values()}


def _id_of(source: RouteSource) -> str:
    return f"route {source.route.id}"

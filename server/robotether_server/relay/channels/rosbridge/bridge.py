"""Passes messages between one operator's WebSocket and one robot's rosbridge.

`rosbridge` makes a `Bridge` a connection, after `access` has let the operator in. What it sends to
the robot is what its `MessageValidator` has written again, and nothing else. It never parses what comes from a
robot, and a message makes no task, no timer and no queue entry of its own, unless a side is full. Reading on one side
waits for writing on the other, so that a connection's memory is bounded by the socket buffers. Tens of thousands of
small messages fit in there: other connections have a turn in between. Only a stop must not wait: while a message of the
operator's does, a few more are read.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import msgspec
from aiohttp import WebSocketError, WSMsgType
from aiohttp.http_websocket import WSMessageNoDecodeText

from robotether_server.contract.codes import CLOSE_CODES
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.channels.rosbridge.drive_path import (
    CommandTimestamps,
    DriveLease,
    DrivePath,
)
from robotether_server.relay.channels.rosbridge.message_validator import (
    FLOOD_AFTER_S,
    MIN_FLOOD_PER_S,
    STOP,
    MessageRefusedError,
    MessageValidator,
    ValidatedMessage,
    read_stop,
    status_error,
)
from robotether_server.relay.channels.rosbridge.subscriptions import TopicSharing, change
from robotether_server.relay.control.control import Control
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.event_loop import PieceTurns, next_turn
from robotether_server.relay.http.sockets import (
    SEND_BUFFER_BYTES,
    ClientConnection,
    OperatorConnection,
    OperatorSocket,
    RobotSocket,
    close_reason_of_broken,
    why_closed,
)
from robotether_server.relay.http.timing import Excess, LivenessLimits, TimeHistogram
from robotether_server.relay.robots.session_messages import SeenReport

T = TypeVar("T")

# Time limit for the robot's session to end after rosbridge's connection: a lost tunnel ends both in
# either order, and the operator reads which of the two it was.
LINK_GRACE_S = 0.3
# How much is read ahead of a message that waits, to find a stop; one more message may go beyond the bytes.
MAX_AHEAD, MAX_AHEAD_BYTES = 1000, SEND_BUFFER_BYTES
# Maximum size of large messages that observers have not read; with copies and the next messages the
# relay holds three times that.
MAX_OBSERVERS_BYTES = 128 * 1024 * 1024
PASSED_ON = frozenset((WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.PING, WSMsgType.PONG))


@dataclass
class Traffic:
    """What all bridges have passed on since the start; `metrics` reads it."""

    messages_to_robot: int = 0
    messages_to_client: int = 0
    bytes_to_robot: int = 0
    bytes_to_client: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    # Of drive commands as they are sent, and of drivers.
    command_ages: TimeHistogram = field(default_factory=TimeHistogram)
    round_trips: TimeHistogram = field(default_factory=TimeHistogram)
    piece_turns: PieceTurns = field(default_factory=PieceTurns)
    # Observers that take a large message now: its bytes, and since when. The slowest is the first.
    taking: dict[OperatorConnection, tuple[int, float]] = field(default_factory=dict)

    def count_to_robot(self, size: int) -> None:
        """Count a message that went to a robot."""
        self.messages_to_robot += 1
        self.bytes_to_robot += size

    def count_to_client(self, size: int) -> None:
        """Count a message that went to a client."""
        self.messages_to_client += 1
        self.bytes_to_client += size

    @contextmanager
    def taken(self, observer: OperatorConnection, size: int) -> Iterator[None]:
        """Count a large message that an observer is sent; the slowest go when all have too much to take."""
        now = asyncio.get_running_loop().time()
        self.taking[observer] = size, now
        while sum(size for size, _ in self.taking.values()) > MAX_OBSERVERS_BYTES:
            slowest = next(iter(self.taking))
            _, since = self.taking.pop(slowest)
            slowest.end(close_reasons.client_slow(slowest.name, round(now - since, 1)))
        try:
            yield
        finally:
            self.taking.pop(observer, None)


@dataclass(frozen=True)
class RobotEnd:
    """The robot's end of a connection; `lease` is that of a driver, `counted` counts what comes while it is open."""

    socket: RobotSocket
    lease: DriveLease | None
    counted: AbstractContextManager[None]


async def close_reason_of_gone_robot(robot: str, why: str = "its connection broke") -> CloseReason:
    """Return why a robot's end is gone, after a while: a lost link, lease or stop ends the connection itself then."""
    await asyncio.sleep(LINK_GRACE_S)
    return close_reasons.rosbridge_down(robot, why)


async def until_robot_gone(work: Awaitable[T], robot: str) -> T | CloseReason:
    """Return what the work does, or why the robot's end is gone that it writes to."""
    try:
        return await work
    except ConnectionError:
        return await close_reason_of_gone_robot(robot)


class Bridge(ClientConnection):
    """Passes messages between an operator and a robot until something ends it."""

    def __init__(
        self,
        robot: str,
        *,
        validator: MessageValidator,
        operator: OperatorSocket,
        own: OwnOperations,
        limits: LivenessLimits,
        topics: TopicSharing,
        message_limit: int,
        traffic: Traffic,
    ) -> None:
        super().__init__(robot, operator, limits)
        self._topics = topics
        self._validator = validator
        self._own = own
        self._message_limit = message_limit
        self._traffic = traffic
        self._robot: RobotSocket | None = None
        self._drive: DrivePath | None = None
        self._timestamps = CommandTimestamps(time.monotonic())
        # Read while one before them waited, and how many bytes they have.
        self._ahead: deque[WSMessageNoDecodeText] = deque()
        self._ahead_bytes = 0
        # The validator does not see these.
        self._pings = Excess(self._received_s, per_s=MIN_FLOOD_PER_S, for_s=FLOOD_AFTER_S)
        # By kind, for the records.
        self.refused: Counter[str] = Counter()

    @property
    def bytes_passed(self) -> int:
        """How many bytes of messages went either way."""
        return self._to_robot()[0] + self._bytes_to_client

    async def run(self, connect: Callable[[], Awaitable[RobotEnd]]) -> CloseReason:
        """Reach the robot and pass messages; return why that ended. `farewell` comes next."""
        if self._ended.done():
            return self._ended.result()
        try:
            return await self._run_until_ended(self._work(connect))
        finally:
            self._topics.close()

    def show_seen(self, report: SeenReport) -> None:
        """Report to the operator how old is what they saw at their newest command."""
        self._own.show_seen(report)

    async def farewell(self, close_reason: CloseReason) -> None:
        """Notify both sides that it ended."""
        await asyncio.gather(self._leave_robot(), self._socket.finish(close_reason))

    def release(self) -> None:
        """Let the robot go, also when the operator vanished and nobody could say farewell."""
        if self._robot is not None:
            self._robot.drop()

    async def _leave_robot(self) -> None:
        if self._robot is not None:
            await self._robot.leave()

    async def _work(self, connect: Callable[[], Awaitable[RobotEnd]]) -> CloseReason:
        robot_end = await connect()
        self._robot = robot = robot_end.socket
        parts = [
            self._pump_to_robot(robot),
            self._pump_to_client(robot),
            self._send_control_updates(),
            self._topics.send(self._deliver, self._deliver_at_once),
            until_robot_gone(self._send_released(robot), self.name),
        ]
        if robot_end.lease is not None:
            self._drive = DrivePath(robot_end.lease, robot, self._timestamps)
            parts.append(until_robot_gone(self._drive.run(), self.name))
        with robot_end.counted:
            return await self._run_together(*parts)

    async def _pump_to_robot(self, robot: RobotSocket) -> CloseReason:
        count = 0
        while True:
            count = await next_turn(count)
            message = self._next_ahead() if self._ahead else await self._receive()
            if message.type not in PASSED_ON:
                return self._close_reason_by_client(message)
            if self._ended.done() and read_stop(message.data) is None:
                # The robot may be stopped, also by the message before: what waits must not reach it.
                continue
            work = self._handle(robot, message)
            if self._may_wait(robot, message):
                work = self._reading_ahead(work)
            if (close_reason := await work) is not None:
                return close_reason

    def _next_ahead(self) -> WSMessageNoDecodeText:
        message = self._ahead.popleft()
        if message.type in PASSED_ON:
            self._ahead_bytes -= len(message.data)
        return message

    def _may_wait(self, robot: RobotSocket, message: WSMessageNoDecodeText) -> bool:
        waiting = robot.waiting_bytes() or self._socket.waiting_bytes()
        is_full = bool(waiting) or self._topics.held.is_full
        return is_full or len(message.data) >= SEND_BUFFER_BYTES

    async def _reading_ahead(
        self, work: Coroutine[Any, Any, CloseReason | None]
    ) -> CloseReason | None:
        """Do what waits until one of the sides has room; a stop that comes meanwhile does not wait."""
        working, reading = asyncio.create_task(work), asyncio.create_task(self._read_ahead())
        try:
            await asyncio.wait({working})
        finally:
            working.cancel()
            # Leaves in the socket what is not in `_ahead`.
            reading.cancel()
            await asyncio.gather(working, reading, return_exceptions=True)
        if not reading.cancelled():
            reading.result()
        return working.result()

    async def _read_ahead(self) -> None:
        while len(self._ahead) < MAX_AHEAD and self._ahead_bytes < MAX_AHEAD_BYTES:
            message = await self._receive()
            stop = read_stop(message.data) if message.type in PASSED_ON else None
            if stop is not None:
                self._own.answer(STOP, stop)
                continue
            self._ahead.append(message)
            if message.type not in PASSED_ON:
                return
            self._ahead_bytes += len(message.data)

    async def _handle(
        self, robot: RobotSocket, message: WSMessageNoDecodeText
    ) -> CloseReason | None:
        if message.type is WSMsgType.PING or message.type is WSMsgType.PONG:
            await self._on_ping_or_pong(message.type, message.data)
            return None
        return await until_robot_gone(self._pass_on(robot, message.data), self.name)

    async def _on_ping_or_pong(self, kind: WSMsgType, payload: bytes) -> None:
        if self._pings.add(self._received_s, 1):
            raise ConnectionClosedError(close_reasons.client_floods(self.name))
        if kind is WSMsgType.PING:
            await self._socket.pong(payload)
        else:
            self._on_pong(payload)

    def _on_pong(self, payload: bytes) -> None:
        sent_at = self._timestamps.pong(payload)
        if sent_at is not None and self._drive is not None:
            self._drive.log.round_trip((time.monotonic() - sent_at) * 1000)

    async def _pass_on(self, robot: RobotSocket, data: bytes) -> None:
        try:
            checked = self._validator.check(data)
        except MessageRefusedError as refused:
            self.refused[refused.kind] += 1
            self._traffic.refused[refused.kind] += 1
            if refused.floods:
                raise ConnectionClosedError(close_reasons.client_floods(self.name)) from refused
            if refused.answer is not None:
                await self._send_to_client(refused.answer, WSMsgType.TEXT)
            return
        if checked.own is not None:
            await self._do_own(checked.operation, checked.own)
            return
        if self._drive is not None:
            self._drive.log.message()
        if checked.subscription is not None:
            change(self._topics, checked.subscription, checked.requested)
            return
        await self._send_to_robot(robot, checked)

    async def _send_to_robot(self, robot: RobotSocket, checked: ValidatedMessage) -> None:
        if checked.drive is None or self._drive is None:
            await self._topics.held.room()
            is_published = checked.topic is not None
            if not self._topics.held.add(checked.data, is_published=is_published):
                await self._send_as_it_is(robot, checked.data)
            return
        complaint = await self._drive.submit(checked.drive)
        if complaint is not None:
            answer = status_error(complaint, checked.drive.message.get("id"))
            await self._send_to_client(answer, WSMsgType.TEXT)

    async def _send_as_it_is(self, robot: RobotSocket, data: bytes) -> None:
        self._traffic.count_to_robot(len(data))
        await robot.send_frame(data, WSMsgType.TEXT)

    async def _send_released(self, robot: RobotSocket) -> CloseReason:
        while True:
            await self._send_as_it_is(robot, await self._topics.held.next())

    async def _do_own(self, operation: str, own: Mapping[str, Any]) -> None:
        answer = self._own.answer(operation, own)
        # Behind data that waits it would come late, and keep what comes from the client waiting.
        if answer is not None and not self._socket.waiting_bytes():
            await self._send_to_client(answer, WSMsgType.TEXT)

    async def _send_control_updates(self) -> CloseReason:
        with self._own.watched():
            while True:
                await self._send_to_client(await self._own.next_update(), WSMsgType.TEXT)

    async def _pump_to_client(self, robot: RobotSocket) -> CloseReason:
        while True:
            message = await robot.next_message()
            if message.type is not WSMsgType.TEXT and message.type is not WSMsgType.BINARY:
                return await self._close_reason_of_robot(message)
            await self._deliver(message.data, message.type)

    async def _deliver(self, data: bytes, kind: WSMsgType) -> None:
        self._traffic.count_to_client(len(data))
        if self._drive is None and len(data) > SEND_BUFFER_BYTES:
            self._bytes_to_client += len(data)
            with self._traffic.taken(self, len(data)):
                await self._socket.send_large(data, kind, self._traffic.piece_turns)
        else:
            await self._send_to_client(data, kind)

    def _deliver_at_once(self, data: bytes, kind: WSMsgType) -> bool:
        if len(data) > SEND_BUFFER_BYTES or not self._socket.send_at_once(data, kind):
            return False
        self._traffic.count_to_client(len(data))
        self._bytes_to_client += len(data)
        return True

    async def _send_to_client(self, data: bytes, kind: WSMsgType) -> None:
        self._bytes_to_client += len(data)
        try:
            await self._socket.send_frame(data, kind)
        except ConnectionError as exc:
            raise ConnectionClosedError(close_reasons.client_vanished(self.name)) from exc

    def _to_robot(self) -> tuple[int, int]:
        robot = self._robot
        return (0, 0) if robot is None else (robot.sent_bytes, robot.waiting_bytes())

    def _robot_slow(self, limit_s: float) -> CloseReason:
        return close_reasons.rosbridge_down(self.name, f"it took nothing for {limit_s:g} s")

    def _next_ping(self) -> bytes:
        return self._timestamps.ping(time.monotonic())

    def _close_reason_by_code(self, code: int) -> CloseReason:
        gave_up = code == CLOSE_CODES["control_given_up"].number
        of_intent = close_reasons.control_given_up if gave_up else close_reasons.client_left
        return of_intent(self.name)

    async def _close_reason_of_robot(self, last: WSMessageNoDecodeText) -> CloseReason:
        if last.type is WSMsgType.CLOSE:
            return close_reasons.rosbridge_down(self.name, why_closed(last))
        if isinstance(last.data, WebSocketError):
            sender, limit = f"robot {self.name}", self._message_limit
            return close_reason_of_broken(last.data, sender, limit)
        return await close_reason_of_gone_robot(self.name)


class OwnOperations:
    """What one connection may ask of the relay itself: clock syncs, the control object, and the stop.

    Only a client that sends clock syncs gets any of these, so that other rosbridge clients never see them. None reaches
    a robot, and none waits for the database. What comes from a robot passes unread, so a robot can write the same
    operations: the key in a client's clock syncs, which no robot sees, shows which ones are the relay's.
    """

    def __init__(self, control: Control, robot: RelayRobot, user: str, address: str | None) -> None:
        self._control = control
        self._robot = robot
        self._user = user
        self._address = address
        self._clock_syncs = False
        self._key: dict[str, object] = {}
        self._update_due = asyncio.Event()
        self._has_changed = False
        # The control object's message that was sent last.
        self._sent = b""
        # Until it is sent.
        self._seen: SeenReport | None = None

    def watched(self) -> AbstractContextManager[None]:
        """Be notified of changes inside the block."""
        return self._control.watched(self._robot.id, self._changed)

    def answer(self, operation: str, own: Mapping[str, Any]) -> bytes | None:
        """Do what the client asks; return the answer."""
        if operation == "robotether.stop":
            self._control.stops.stop(
                self._robot, self._user, address=self._address, press=own.get("press")
            )
            # Its answer, also where it changes nothing: whoever repeats a stop must learn that it came.
            self._sent = b""
            self._changed()
            return None
        self._key = {"key": own["key"]} if "key" in own else {}
        if not self._clock_syncs:
            self._clock_syncs = True
            self._changed()
        relay_ms = round(time.monotonic() * 1000, 3)
        return _written(operation, t_ms=own.get("t_ms"), relay_ms=relay_ms, **self._key)

    def show_seen(self, report: SeenReport) -> None:
        """Send how old is what the client's operator saw, at most, at the commands of a report."""
        self._seen = report
        if self._clock_syncs:
            self._update_due.set()

    async def next_update(self) -> bytes:
        """Wait until there is something to send; return its message, the control object's first."""
        while True:
            await self._update_due.wait()
            if self._seen is not None and not self._has_changed:
                seen, self._seen = self._seen, None
                self._update_due.clear()
                return self._seen_message(seen)
            self._has_changed = False
            if self._seen is None:
                self._update_due.clear()
            control = msgspec.to_builtins(self._control.describe(self._robot.id))
            message = _written("robotether.control", control=control, **self._key)
            # A guard reports also where nothing of it is another.
            if message != self._sent:
                self._sent = message
                return message

    def _seen_message(self, seen: SeenReport) -> bytes:
        limits = {"max_speed_m_s": seen.max_speed_m_s, "max_turn_rad_s": seen.max_turn_rad_s}
        # What is unknown may be older than all others.
        known_ms = [age_ms for age_ms in seen.ages_ms if age_ms is not None]
        age_ms = max(known_ms) if len(known_ms) == len(seen.ages_ms) else None
        return _written("robotether.seen", age_ms=age_ms, **limits, **self._key)

    def _changed(self) -> None:
        if self._clock_syncs:
            self._has_changed = True
            self._update_due.set()


def _written(operation: str, **members: object) -> bytes:
    return json.dumps({"op": operation, **members}, separators=(",", ":")).encode()

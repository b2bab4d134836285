"""Reads drive commands, bounds their age, and sends them to the robot, stamped for the guard.

The message validator makes a `DriveCommand` of each publish to a drive topic that passes. `handler` makes a
`DrivePath` for each connection with a lease, and `bridge` hands it every command. A command never waits behind
another: when the robot's side is full, only the newest of each topic waits, and it goes on if it is young enough by
then. A command that is too old must never go on, and what is no drive command must never pass as one.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn

from aiohttp import WSMsgType
from robotether_common.guard import STAMP
from robotether_common.ros import ACKERMANN, ACKERMANN_STAMPED, AXES, TWIST, TWIST_STAMPED

from robotether_server.relay.drives.drive_log import DriveLog
from robotether_server.relay.http.rate_limiter import RateLimiter
from robotether_server.relay.http.sockets import RobotSocket
from robotether_server.relay.robots.robot_clock import RobotClock
from robotether_server.relay.rosbridge.fields import FieldRefusedError

# Pings may be unanswered as long as a silent client is waited for; of more, the oldest are forgotten.
MAX_PINGS_OPEN = 64
# Two clocks drift apart by less between clock syncs; some browsers round theirs to 0.1 s.
AHEAD_S = 0.25
_SEQUENCE = struct.Struct("!Q")
# Clients drive one or two topics.
MAX_WAITING = 8
POLL_EVERY_S = 0.005

_AXES = frozenset(AXES)
_STAMPED = b'%%b,"%b":{"t_ms":%%.3f,"fence":%%d}}' % STAMP.encode()


class DriveCommand(NamedTuple):
    """A publish to a drive topic that passed; `data` is `message` as it is written."""

    topic: str
    message: Mapping[str, Any]
    data: bytes
    # When the input event was on the relay's clock, as far as the client says.
    stamp_ms: float | None
    speed_m_s: float
    # None: the command says how to steer, not how fast to turn.
    turn_rad_s: float | None


def stamped(command: DriveCommand, t_ms: float, fence: int) -> bytes:
    """Write a command for the guard, with its moment on the robot's clock and the lease's number."""
    return _STAMPED % (command.data[:-1], t_ms, fence)


def speeds(msg: Mapping[str, Any]) -> tuple[float, float | None]:
    """Return the speed in m/s and the turn in rad/s; raise FieldRefusedError when it is no command.

    The shape tells the type: geometry_msgs/Twist and TwistStamped, ackermann_msgs/AckermannDriveStamped. A member
    that is missing is zero, as it is to rosbridge.
    """
    members = msg.keys()
    if members <= TWIST:
        return _of_twist(msg)
    if members <= TWIST_STAMPED:
        return _of_twist(_object(msg.get("twist", {}), TWIST))
    if members <= ACKERMANN_STAMPED:
        drive = _object(msg.get("drive", {}), ACKERMANN)
        for value in drive.values():
            _finite(value)
        return abs(_finite(drive.get("speed", 0.0))), None
    raise FieldRefusedError(
        "is neither a Twist, a TwistStamped nor an AckermannDriveStamped, which a drive topic takes"
    )


def _of_twist(twist: Mapping[str, Any]) -> tuple[float, float]:
    return _length(twist.get("linear", {})), _length(twist.get("angular", {}))


def _length(vector: Any) -> float:
    return _finite(math.hypot(*map(_finite, _object(vector, _AXES).values())))


def _object(value: Any, known: frozenset[str]) -> Mapping[str, Any]:
    if not isinstance(value, dict) or not value.keys() <= known:
        raise FieldRefusedError(f"has a part that is no object of {', '.join(sorted(known))}")
    return value


def _finite(value: Any) -> float:
    # True is a number to Python only.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise FieldRefusedError("holds a speed that is no finite number")
    return float(value)


class CommandTimestamps:
    """The earliest time at which each command of one connection can have been sent, so that its age is a bound.

    A client that stamps its commands says the time itself, on our clock as its clock syncs tell it. Of another
    one it is known that a message behind a pong is younger than that pong's ping. Times are seconds of
    time.monotonic().
    """

    def __init__(self, opened_at: float) -> None:
        # Nothing can have been sent before the connection was open.
        self._earliest = opened_at
        self._sequence = 0
        self._open: deque[tuple[int, float]] = deque(maxlen=MAX_PINGS_OPEN)

    def ping(self, now: float) -> bytes:
        """Return the payload of a ping that is sent now."""
        self._sequence += 1
        self._open.append((self._sequence, now))
        return _SEQUENCE.pack(self._sequence)

    def pong(self, payload: bytes) -> float | None:
        """A pong came; return when its ping was sent. None: it answers none of our open pings, and says nothing."""
        if len(payload) != _SEQUENCE.size:
            return None
        (sequence,) = _SEQUENCE.unpack(payload)
        if not any(sequence == each for each, _ in self._open):
            return None
        while self._open and self._open[0][0] <= sequence:
            _, self._earliest = self._open.popleft()
        return self._earliest

    def of(self, stamp_ms: float | None, now: float) -> float | None:
        """Return the earliest moment of a command that came now; None: it says one that is to come."""
        if stamp_ms is None:
            return self._earliest
        # Such a client's clock is wrong, or ours stood still: its commands would never grow old.
        return None if stamp_ms / 1000 > now + AHEAD_S else min(stamp_ms / 1000, now)


@dataclass(frozen=True)
class DriveLease:
    """A driver's lease, and what its commands need; `clock` None: nobody on the robot reads stamps."""

    fence: int
    max_age_s: float
    clock: RobotClock | None
    log: DriveLog
    on_command: Callable[[], None]


class DrivePath:
    """Sends a driver's commands."""

    def __init__(
        self,
        lease: DriveLease,
        robot: RobotSocket,
        timestamps: CommandTimestamps,
        sent: Callable[[int], None],
    ) -> None:
        self.log = lease.log
        self._lease = lease
        self._robot = robot
        self._timestamps = timestamps
        self._sent = sent
        # By topic, in the order in which they came: the command and its moment.
        self._waiting: dict[str, tuple[DriveCommand, float]] = {}
        self._wake = asyncio.Event()
        self._warnings = RateLimiter(time.monotonic(), per_s=1, at_once=1)

    async def submit(self, command: DriveCommand) -> str | None:
        """Send the command or let it wait; return what a client is told whose command is refused."""
        now = time.monotonic()
        timestamp = self._timestamps.of(command.stamp_ms, now)
        if timestamp is None:
            return self._refuse(
                command, "its timestamp lies ahead, by the clock that the beats show", now
            )
        if now - timestamp > self._lease.max_age_s:
            age_ms, limit_ms = (now - timestamp) * 1000, self._lease.max_age_s * 1000
            why = f"the command is {age_ms:.0f} ms old, over {limit_ms:g} ms"
            return self._refuse(command, why, now)
        self._lease.on_command()
        if self._waiting or self._robot.waiting_bytes():
            self._wait(command, timestamp)
        else:
            await self._send(command, timestamp, now)
        return None

    async def run(self) -> NoReturn:
        """Send what waits, as soon as there is room."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._waiting:
                await asyncio.sleep(POLL_EVERY_S)
                if not self._robot.waiting_bytes():
                    await self._send_waiting()

    def _wait(self, command: DriveCommand, timestamp: float) -> None:
        if self._waiting.pop(command.topic, None) is not None:
            self.log.dropped()
        self._waiting[command.topic] = (command, timestamp)
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]
            self.log.dropped()
        self._wake.set()

    async def _send_waiting(self) -> None:
        topic = next(iter(self._waiting))
        command, timestamp = self._waiting.pop(topic)
        now = time.monotonic()
        if now - timestamp > self._lease.max_age_s:
            self.log.dropped()
        else:
            await self._send(command, timestamp, now)

    async def _send(self, command: DriveCommand, timestamp: float, now: float) -> None:
        data, lease = command.data, self._lease
        if lease.clock is not None:
            t_ms = lease.clock.at(now, timestamp)
            if t_ms is None:
                # The guard would refuse what nobody knows the age of.
                self.log.dropped()
                return
            data = stamped(command, t_ms, lease.fence)
        self.log.command(now, command.speed_m_s, command.turn_rad_s)
        self._sent(len(data))
        await self._robot.send_frame(data, WSMsgType.TEXT)

    def _refuse(self, command: DriveCommand, why: str, now: float) -> str | None:
        self.log.dropped()
        if not self._warnings.allow(now):
            return None
        return f"cannot publish to {command.topic}: {why}"

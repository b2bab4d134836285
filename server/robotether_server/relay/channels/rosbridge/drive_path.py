"""Bounds the age of drive commands, and sends them to the robot, stamped for the guard.

The message validator makes a `DriveCommand` of each publish to a drive topic that passes. `bridge` makes a `DrivePath`
for each connection with a lease, and hands it every command. A command never waits behind another: when the robot's
side is full, only the newest of each topic waits, and it goes on if it is young enough by then. A command that is too
old must never go on, unless it says to stand still.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn

import msgspec
from aiohttp import WSMsgType
from robotether_common.guard import STAMP
from robotether_common.ros import ACKERMANN_RATES

from robotether_server.relay.http.sockets import RobotSocket
from robotether_server.relay.http.timing import RateLimiter, RobotClock
from robotether_server.relay.robots.delivered_frames import NamedFrame
from robotether_server.relay.robots.drive_log import DriveLog
from robotether_server.relay.robots.recorders import Outcome

# Maximum number of unanswered pings; beyond it the oldest are dropped.
MAX_PINGS_OPEN = 64
# Maximum time by which a timestamp may be ahead: clocks drift between clock syncs, and some
# browsers round theirs to 0.1 s.
AHEAD_S = 0.25
_written = msgspec.json.Encoder().encode
_SEQUENCE = struct.Struct("!Q")
# Maximum number of topics whose newest command waits; clients drive one or two.
MAX_WAITING = 8
POLL_EVERY_S = 0.005
_STAMPED = b'%%b,"%b":{"t_ms":%%.3f,"fence":%%d%%b}}' % STAMP.encode()
_SEEN = b',"seen":%b'


class DriveStamp(NamedTuple):
    """What a client says of a drive command beside `msg`."""

    # When the input event was on the relay's clock; None: it does not say.
    t_ms: float | None = None
    # The frames on the driver's screens, with the numbers that the viewer got; None: the client names none.
    seen: tuple[NamedFrame, ...] | None = None


class DriveCommand(NamedTuple):
    """A publish to a drive topic that passed; `data` is `message` as it is written."""

    topic: str
    message: Mapping[str, Any]
    data: bytes
    stamp: DriveStamp
    speed_m_s: float
    # None: the command says how to steer, not how fast to turn.
    turn_rad_s: float | None

    @property
    def stands(self) -> bool:
        """Whether the robot is to stand still; some that steer like cars follow the rates alone."""
        drive = self.message.get("msg", {}).get("drive", {})
        return not (self.speed_m_s or self.turn_rad_s or any(map(drive.get, ACKERMANN_RATES)))


def stamped(
    command: DriveCommand, t_ms: float, fence: int, seen: Sequence[NamedFrame] | None = None
) -> bytes:
    """Write a command for the guard: its timestamp on the robot's clock, the lease's number, and the robot's frames."""
    views = b"" if seen is None else _SEEN % _written(seen)
    return _STAMPED % (command.data[:-1], t_ms, fence, views)


class CommandTimestamps:
    """The earliest time at which each command of one connection can have been sent, so that its age is a bound.

    A client that stamps its commands says the time itself, on our clock as its clock syncs give it. Of another
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
        if not any(sequence == number for number, _ in self._open):
            return None
        while self._open and self._open[0][0] <= sequence:
            _, self._earliest = self._open.popleft()
        return self._earliest

    def of(self, stamp_ms: float | None, now: float) -> float | None:
        """Return the earliest timestamp of a command that came now; None: it claims one in the future."""
        if stamp_ms is None:
            return self._earliest
        # Such a client's clock is wrong, or ours stopped: its commands would never grow old.
        return None if stamp_ms / 1000 > now + AHEAD_S else min(stamp_ms / 1000, now)


class CommandReport(NamedTuple):
    """What became of a command; `age_s` None: nobody knows; `size` in bytes as it was sent, 0: it was not."""

    command: DriveCommand
    age_s: float | None
    outcome: Outcome
    size: int = 0


@dataclass(frozen=True)
class DriveLease:
    """A driver's lease, and what its commands need; `clock` None: nobody on the robot reads stamps.

    `robots_frame` gives a frame that the driver names under the robot's own number, unknown if it was not sent to them.
    `on_report` is told what became of each command.
    """

    fence: int
    max_age_s: float
    clock: RobotClock | None
    log: DriveLog
    on_command: Callable[[], None]
    robots_frame: Callable[[NamedFrame], NamedFrame] = lambda named: NamedFrame(named.camera, None)
    on_report: Callable[[CommandReport], None] = lambda _: None


class DrivePath:
    """Sends a driver's commands."""

    def __init__(
        self, lease: DriveLease, robot: RobotSocket, timestamps: CommandTimestamps
    ) -> None:
        self.log = lease.log
        self._lease = lease
        self._robot = robot
        self._timestamps = timestamps
        # By topic, in the order in which they came: the command and its timestamp.
        self._waiting: dict[str, tuple[DriveCommand, float]] = {}
        self._wake = asyncio.Event()
        self._warnings = RateLimiter(time.monotonic(), per_s=1, at_once=1)

    async def submit(self, command: DriveCommand) -> str | None:
        """Send the command or let it wait; return the answer to a client whose command is refused."""
        now = time.monotonic()
        timestamp = self._timestamps.of(command.stamp.t_ms, now)
        if timestamp is None:
            self._lease.on_report(CommandReport(command, None, "ahead"))
            return self._refuse(
                command, "its timestamp lies ahead, by the clock of robotether.clock_sync", now
            )
        if self._is_too_old(command, timestamp, now):
            self._lease.on_report(CommandReport(command, now - timestamp, "too_old"))
            age_ms, limit_ms = (now - timestamp) * 1000, self._lease.max_age_s * 1000
            why = f"the command is {age_ms:.0f} ms old, over {limit_ms:g} ms"
            return self._refuse(command, why, now)
        self._lease.on_command()
        if self._waiting or self._robot.waiting_bytes():
            self._wait(command, timestamp)
        else:
            await self._send(command, timestamp, now)
        return None

    def _is_too_old(self, command: DriveCommand, timestamp: float, now: float) -> bool:
        if now - timestamp <= self._lease.max_age_s:
            return False
        # By a zero the guard stops the robot, and sends on nothing that is old.
        return self._lease.clock is None or not command.stands

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
        if (older := self._waiting.pop(command.topic, None)) is not None:
            self._drop(*older, "replaced")
        self._waiting[command.topic] = (command, timestamp)
        if len(self._waiting) > MAX_WAITING:
            self._drop(*self._waiting.pop(next(iter(self._waiting))), "replaced")
        self._wake.set()

    async def _send_waiting(self) -> None:
        topic = next(iter(self._waiting))
        command, timestamp = self._waiting.pop(topic)
        now = time.monotonic()
        if self._is_too_old(command, timestamp, now):
            self._drop(command, timestamp, "too_old")
        else:
            await self._send(command, timestamp, now)

    async def _send(self, command: DriveCommand, timestamp: float, now: float) -> None:
        data, lease = command.data, self._lease
        if lease.clock is not None:
            t_ms = lease.clock.at(now, timestamp)
            if t_ms is None and command.stands:
                # Of unknown age: the guard takes it for an old one, and stops the robot.
                t_ms = 0.0
            if t_ms is None:
                # The guard would refuse what nobody knows the age of.
                self._drop(command, timestamp, "clock_unknown")
                return
            data = stamped(command, t_ms, lease.fence, self._robots_frames(command))
        self.log.command(now, command.speed_m_s, command.turn_rad_s)
        await self._robot.send_frame(data, WSMsgType.TEXT)
        lease.on_report(CommandReport(command, now - timestamp, "sent", len(data)))

    def _drop(self, command: DriveCommand, timestamp: float, outcome: Outcome) -> None:
        self.log.dropped()
        self._lease.on_report(CommandReport(command, time.monotonic() - timestamp, outcome))

    def _robots_frames(self, command: DriveCommand) -> list[NamedFrame] | None:
        seen = command.stamp.seen
        return None if seen is None else [self._lease.robots_frame(named) for named in seen]

    def _refuse(self, command: DriveCommand, why: str, now: float) -> str | None:
        self.log.dropped()
        if not self._warnings.allow(now):
            return None
        return f"cannot publish to {command.topic}: {why}"

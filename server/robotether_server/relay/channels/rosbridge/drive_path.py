"""Bounds the age of drive commands, sends them to the robot, stamped for the guard, and counts the drive.

The message validator makes a `DriveCommand` of each publish to a drive topic that passes. `bridge` makes a `DrivePath`
for each connection with a lease, and hands it every command. A command never waits behind another: when the robot's
side is full, only the newest of each topic waits, and it goes on if it is young enough by then. A command that is too
old must never go on, unless it says to stand still.

Each drive has a `DriveLog`, which `handler` makes; `observers` writes its entry while the drive lasts and at its end.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple, NoReturn

import msgspec
from aiohttp import WSMsgType
from robotether_common.guard import STAMP
from robotether_common.ros import ACKERMANN_RATES

from robotether_server.db.control import DriveEntry
from robotether_server.relay.http.sockets import RobotSocket
from robotether_server.relay.http.timing import RateLimiter, RobotClock
from robotether_server.relay.robots.delivered_frames import NamedFrame
from robotether_server.relay.robots.recorders import Outcome
from robotether_server.relay.robots.session_messages import Position, SeenReport
from robotether_server.relay.robots.viewer_stats import NOTHING, ViewerCounts

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
# Before the guard's kinds: some have the name of a kind of the policy's.
GUARD = "guard_"
MIN_LATENCY_MS, MAX_LATENCY_MS = 0.1, 60_000.0
LATENCY_STEP = math.log(1.02)
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


@dataclass(frozen=True)
class DriveCounters:
    """What others count while a drive lasts, as it is now.

    Bytes that its connection passed; the robot's own round trip in ms, None: unknown; what the driver got of the
    robot's video, counted from any time before the drive. `on_round_trip` is told each one of the driver, and of the
    robot, in ms. `position` is where the robot is now, None: unknown.
    """

    passed_bytes: Callable[[], int] = lambda: 0
    robot_rtt_ms: Callable[[], float | None] = lambda: None
    viewer_counts: Callable[[], ViewerCounts] = lambda: NOTHING
    on_round_trip: Callable[[float, float | None], None] = lambda _driver_ms, _robot_ms: None
    position: Callable[[], Position | None] = lambda: None


class DriveLog:
    """Counts one drive: commanded distance, turn and speeds, messages, refusals, latency, what was seen, frames.

    A command counts until the next, and no longer than the guard lets it: the robot stops by itself then. Pure: no
    clock of its own.
    """

    def __init__(
        self,
        entry: DriveEntry,
        deadman_s: float,
        refused: Counter[str],
        counters: DriveCounters = DriveCounters(),
        show_seen: Callable[[SeenReport], None] = lambda _: None,
    ) -> None:
        self.entry = entry
        self._show_seen = show_seen
        self._counters = counters
        self._viewed_before = counters.viewer_counts()
        self._latency = LatencyHistogram()
        self._seen = LatencyHistogram()
        self._refused = refused
        self._refused_by_guard: Counter[str] = Counter()
        # None: it goes on.
        self.ended_s: float | None = None
        self._deadman_s = deadman_s
        # When the last command was sent, with its speeds.
        self._last = (0.0, 0.0, 0.0)
        entry.start_x_m, entry.start_y_m = counters.position() or (None, None)

    def command(self, now: float, speed_m_s: float, turn_rad_s: float | None) -> None:
        """A command went to the robot."""
        entry, turn = self.entry, turn_rad_s or 0.0
        self._count_until(now)
        self._last = (now, speed_m_s, turn)
        entry.top_speed_m_s = max(entry.top_speed_m_s, speed_m_s)
        if turn_rad_s is None and speed_m_s:
            # How fast it turns, the robot alone knows.
            entry.turned_rad = entry.top_turn_rad_s = None
        if entry.top_turn_rad_s is not None:
            entry.top_turn_rad_s = max(entry.top_turn_rad_s, turn)

    def message(self) -> None:
        """A message went to the robot."""
        self.entry.messages += 1

    def dropped(self) -> None:
        """A command was too old."""
        self.entry.dropped_old += 1

    def round_trip(self, driver_ms: float) -> None:
        """The driver answered a ping; the way on to the robot is added as it is now, if it is known."""
        robot_ms = self._counters.robot_rtt_ms()
        self._counters.on_round_trip(driver_ms, robot_ms)
        if robot_ms is not None:
            self._latency.add(driver_ms + robot_ms)

    def refused_by_guard(self, more: Mapping[str, int]) -> None:
        """Count further messages that the guard refused, by kind; the report may follow the drive's end."""
        self._refused_by_guard.update(more)

    def on_seen(self, report: SeenReport) -> None:
        """The guard reported what a driver saw; another drive's is of no use here."""
        entry, ages_ms = self.entry, report.ages_ms
        if report.fence != entry.fence:
            return
        if report.slowed_s is not None:
            entry.slowed_s = round((entry.slowed_s or 0.0) + report.slowed_s, 3)
        if not ages_ms:
            return
        measured_ms = [age_ms for age_ms in ages_ms if age_ms is not None]
        for age_ms in measured_ms:
            self._seen.add(age_ms)
        if measured_ms:
            entry.seen_max_ms = oldest_ms = max(*measured_ms, entry.seen_max_ms or 0.0)
            entry.seen_p50_ms, entry.seen_p95_ms, entry.seen_p99_ms = (
                min(self._seen.quantile(share) or 0.0, oldest_ms) for share in (0.5, 0.95, 0.99)
            )
        entry.seen_unknown = (entry.seen_unknown or 0) + len(ages_ms) - len(measured_ms)
        self._show_seen(report)

    def written(self) -> DriveEntry:
        """Return the entry as it is now."""
        if self.ended_s is None:
            self._read_counters()
        guards = {f"{GUARD}{kind}": count for kind, count in self._refused_by_guard.items()}
        self.entry.refused = dict(self._refused) | guards
        return self.entry

    def end(self, now: float, timestamp: datetime, code: str) -> DriveEntry:
        """Close the books."""
        self._count_until(now)
        # What comes from now on is not this drive's.
        self._read_counters()
        self._last, self.ended_s = (now, 0.0, 0.0), now
        self.entry.ended_at, self.entry.end_code = timestamp, code
        self.entry.stops = int(code == "robot_stopped")
        return self.written()

    def _read_counters(self) -> None:
        entry, counters = self.entry, self._counters
        viewer_counts = counters.viewer_counts().since(self._viewed_before)
        entry.bytes = counters.passed_bytes()
        entry.frames, entry.frame_bytes = viewer_counts.frames, viewer_counts.bytes
        entry.viewed_s = round(viewer_counts.viewed_s, 3)
        entry.end_x_m, entry.end_y_m = counters.position() or (None, None)
        entry.latency_p50_ms = self._latency.quantile(0.5)
        entry.latency_p95_ms = self._latency.quantile(0.95)

    def _count_until(self, now: float) -> None:
        at, speed, turn = self._last
        lasted_s = min(max(now - at, 0.0), self._deadman_s)
        self.entry.distance_m += speed * lasted_s
        if self.entry.turned_rad is not None:
            self.entry.turned_rad += turn * lasted_s


class LatencyHistogram:
    """Round trips, by how long they took, in bounded memory.

    Times are counted in steps that grow by 2 %, so that a quantile is within 1 % of what was measured. What is
    shorter or longer than the bounds counts as these.
    """

    def __init__(self) -> None:
        # At most some 670 steps lie between the bounds.
        self._counts: Counter[int] = Counter()

    def add(self, ms: float) -> None:
        """Count a round trip of `ms`."""
        bounded = min(max(ms, MIN_LATENCY_MS), MAX_LATENCY_MS)
        self._counts[round(math.log(bounded) / LATENCY_STEP)] += 1

    def quantile(self, share: float) -> float | None:
        """Return in ms the time within which this share of all came back; None: there was none."""
        rank = math.ceil(share * self._counts.total())
        for step in sorted(self._counts):
            rank -= self._counts[step]
            if rank <= 0:
                return round(math.exp(step * LATENCY_STEP), 1)
        return None

"""Judges a connection by its timestamps: too many messages, silence, the clock at its other end.

Rates: `robot_link` keeps a `RateLimiter` for the lines of a robot, a `MessageValidator` for the messages of a client,
for the answers to them and for what it refuses, a `Lease` for the questions of each user. Silence: `bridge` and
`frames_handler` feed `Liveness` with what the sockets show, so that a message costs nothing. Clocks: `robot_link` feeds
a `RobotClock` with the agent's pings, drivers' bridges ask it. `metrics` reads what a `TimeHistogram` has counted.

Pure: no network, no clock of its own; each gets its times from its caller.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from typing import Literal

from robotether_server.times import BOUNDS_S

Verdict = Literal["ok", "client_silent", "client_slow", "robot_slow"]

WINDOW_S = 10.0
# Minimum lateness of a look that judges nobody: what came while this process stood still is not read yet.
STALLED_S = 1.0
# Maximum number of samples; if pings come faster than agreed, the oldest are dropped, which only
# makes ages greater.
MAX_SAMPLES = 64


class RateLimiter:
    """A token bucket."""

    def __init__(self, now: float, *, per_s: float, at_once: int) -> None:
        self._per_s = per_s
        self._capacity = at_once
        self._tokens = float(at_once)
        self._filled_at = now

    def allow(self, now: float, count: int = 1) -> bool:
        """Use the rate `count` times; False, and nothing is used, if there is not enough left."""
        filled = self._tokens + (now - self._filled_at) * self._per_s
        self._filled_at = now
        self._tokens = min(filled, self._capacity)
        if self._tokens < count:
            return False
        self._tokens -= count
        return True

    def free_in_s(self, now: float, count: int = 1) -> float:
        """Return the time until it may be used `count` times."""
        left = min(self._tokens + (now - self._filled_at) * self._per_s, self._capacity)
        return max(0.0, (count - left) / self._per_s)


class Excess:
    """Notices who goes on beyond a rate for some seconds; a burst, however large, is not that."""

    def __init__(self, now: float, *, per_s: float, for_s: float) -> None:
        self._for_s = for_s
        self._capacity = max(1, int(per_s * for_s))
        self._reserve = RateLimiter(now, per_s=per_s, at_once=self._capacity)
        self._since = now

    def add(self, now: float, count: int) -> bool:
        """Add `count`; return whether the rate has been exceeded for long enough."""
        if not self._reserve.free_in_s(now, self._capacity):
            self._since = now
        in_reserve = self._reserve.allow(now, min(count, self._capacity))
        return not in_reserve and now - self._since >= self._for_s


@dataclass(frozen=True)
class LivenessLimits:
    """Seconds after which the other side counts as silent or slow."""

    ping_every_s: float = 2.0
    silent_after_s: float = 6.0
    slow_after_s: float = 10.0
    check_every_s: float = 0.5
    # A driver of whom nothing comes holds the lease no longer, whatever waits to be sent to it.
    strict: bool = False


DRIVER_LIMITS = LivenessLimits(ping_every_s=0.2, silent_after_s=2.5, check_every_s=0.1, strict=True)


class Drain:
    """Watches one direction: how long a filled send buffer has not moved."""

    def __init__(self, now: float) -> None:
        self._moved_at = now
        self._left = 0

    def update(self, now: float, written: int, buffered: int) -> None:
        """Take the bytes ever handed to the socket, and those of them still waiting."""
        left = written - buffered
        if buffered == 0 or left != self._left:
            self._moved_at = now
        self._left = left

    def stuck_for_s(self, now: float) -> float:
        """Return for how long nothing has moved; 0 when nothing waits."""
        return now - self._moved_at

    def excuse(self, now: float) -> None:
        """Begin anew: nobody could see whether it moved."""
        self._moved_at = now


class Liveness:
    """Judges one connection from its two send buffers and the time of its last message."""

    def __init__(self, limits: LivenessLimits, now: float) -> None:
        self._limits = limits
        self._to_client = Drain(now)
        self._to_robot = Drain(now)
        self._excused_at = self._looked_at = now

    def check(
        self,
        now: float,
        *,
        received_at: float,
        to_client: tuple[int, int],
        to_robot: tuple[int, int],
    ) -> Verdict:
        """Judge at `now`; the tuples are (bytes written, bytes waiting) of each direction."""
        if now - self._looked_at > self._limits.check_every_s + STALLED_S:
            self._excuse(now)
        self._looked_at = now
        self._to_client.update(now, *to_client)
        self._to_robot.update(now, *to_robot)
        if self._to_client.stuck_for_s(now) > self._limits.slow_after_s:
            return "client_slow"
        if self._to_robot.stuck_for_s(now) > self._limits.slow_after_s:
            return "robot_slow"
        # Behind data that waits, a ping cannot arrive; and while the robot's side is full,
        # the client is not read, so its pongs are not seen. Neither is the client's silence.
        if to_robot[1] or (to_client[1] and not self._limits.strict):
            self._excused_at = now
        if now - max(received_at, self._excused_at) > self._limits.silent_after_s:
            return "client_silent"
        return "ok"

    def _excuse(self, now: float) -> None:
        self._excused_at = now
        self._to_client.excuse(now)
        self._to_robot.excuse(now)


class WindowedMaximum:
    """The greatest of the values of the last seconds, in bounded memory."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self._window_s = window_s
        # Values that no later one exceeds, so the first is the greatest.
        self._samples: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES)

    def add(self, now: float, value: float) -> None:
        """Add a value of this time."""
        while self._samples and self._samples[-1][1] <= value:
            self._samples.pop()
        self._samples.append((now, value))

    def at(self, now: float) -> float | None:
        """Return the greatest value, None when there is none in the window."""
        while self._samples and now - self._samples[0][0] > self._window_s:
            self._samples.popleft()
        return self._samples[0][1] if self._samples else None


class RobotClock:
    """The agent's CLOCK_BOOTTIME, as its pings give it, never too late: clocks are not synchronised.

    A sample is how far the agent's clock was ahead of ours, less the time that its ping was under way; so the greatest
    of the last ones is the truest, and still no greater than the truth. Times of ours are in seconds of the loop's
    clock.
    """

    def __init__(self) -> None:
        self._ahead_ms = WindowedMaximum()

    def on_ping(self, now: float, t_ms: float) -> None:
        """A ping came that was sent when the robot's clock showed `t_ms`."""
        self._ahead_ms.add(now, t_ms - now * 1000)

    def at(self, now: float, timestamp: float) -> float | None:
        """Return in ms what the robot's clock showed at `timestamp`, at most; None: nothing is known."""
        ahead_ms = self._ahead_ms.at(now)
        return None if ahead_ms is None else timestamp * 1000 + ahead_ms


class TimeHistogram:
    """Counts times by the first of `BOUNDS_S` that they do not exceed, and adds them up; a time itself is not kept.

    `counts` has one number more than there are bounds, for what is longer than all.
    """

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_S) + 1)
        self.sum_s = 0.0

    def add(self, time_s: float) -> None:
        """Count a time in seconds."""
        self.counts[bisect_left(BOUNDS_S, time_s)] += 1
        self.sum_s += time_s

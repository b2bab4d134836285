"""Converts the relay's timestamps to a robot's clock, never too late: clocks are not synchronised.

`robot_link` feeds it with the agent's pings, drivers' bridges ask it. A sample is how far the agent's
clock was ahead of ours, less the time that its ping was under way; so the greatest of the last ones is
the truest, and still no greater than the truth. Pure: no network, no clock of its own.
"""

from __future__ import annotations

from collections import deque

WINDOW_S = 10.0
# Pings may come faster than agreed; of so many samples the oldest go early, which only makes ages greater.
MAX_SAMPLES = 64


class WindowedMaximum:
    """The greatest of the values of the last seconds, in bounded memory."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self._window_s = window_s
        # Values that no later one exceeds, so the first is the greatest.
        self._samples: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES)

    def add(self, now: float, value: float) -> None:
        """Take a value of this moment."""
        while self._samples and self._samples[-1][1] <= value:
            self._samples.pop()
        self._samples.append((now, value))

    def at(self, now: float) -> float | None:
        """Return the greatest value, None when there is none in the window."""
        while self._samples and now - self._samples[0][0] > self._window_s:
            self._samples.popleft()
        return self._samples[0][1] if self._samples else None


class RobotClock:
    """The agent's CLOCK_BOOTTIME, as its pings tell it. Moments of ours are in seconds of the loop's clock."""

    def __init__(self) -> None:
        self._ahead_ms = WindowedMaximum()

    def on_ping(self, now: float, t_ms: float) -> None:
        """A ping came that was sent when the robot's clock showed `t_ms`."""
        self._ahead_ms.add(now, t_ms - now * 1000)

    def at(self, now: float, timestamp: float) -> float | None:
        """Return in ms what the robot's clock showed at `timestamp`, at most; None: nothing is known."""
        ahead_ms = self._ahead_ms.at(now)
        return None if ahead_ms is None else timestamp * 1000 + ahead_ms

"""The clock by which ages of commands are judged, and the numbers of sessions; the session reports both."""

from __future__ import annotations

import time


def robot_time() -> float:
    """Return the seconds since the robot started, those in which it slept included.

    A clock that stops in sleep would call what was sent before young when the robot wakes up.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class EpochClock:
    """Numbers a robot's sessions: of two at different cells, the one with the greater number is the newer.

    The wall clock makes the number greater than those before a restart; a clock that is set back meanwhile never does
    within one process.
    """

    def __init__(self) -> None:
        self._last = 0

    def next(self) -> int:
        """Return the number of a session that starts now, in milliseconds since 1970."""
        self._last = max(self._last + 1, time.time_ns() // 1_000_000)
        return self._last

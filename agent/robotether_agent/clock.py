"""The clock by which ages of commands are judged; the session reports it to the server."""

from __future__ import annotations

import time


def robot_time() -> float:
    """Return the seconds since the robot started, those in which it slept included.

    A clock that stops in sleep would call what was sent before young when the robot wakes up.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME)

"""When a frame was taken, on the robot's own clock, out of the stamp that its source gave.

web_video_server writes `X-Timestamp` in seconds with six digits. For ROS 1, and first for ROS 2, it is the camera's
stamp: wall time, unless the robot runs on simulated time. Newer ones for ROS 2 write std::chrono::steady_clock when
they send, which is CLOCK_MONOTONIC. A stamp that is near neither clock says nothing, and the frame's arrival counts.
Never tells a moment later than the arrival.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from robotether_agent.clock import robot_time

# What is older than this was stamped by another clock than this robot's.
NEAR_S = 10.0


@dataclass(frozen=True)
class Now:
    """One moment on three clocks: since the robot's start, in Unix time, and CLOCK_MONOTONIC."""

    robot_s: float
    wall_s: float
    steady_s: float


def now() -> Now:
    """Look at the three clocks."""
    return Now(robot_time(), time.time(), time.clock_gettime(time.CLOCK_MONOTONIC))


def timestamp_of(stamp_s: float | None, arrived: Now) -> tuple[float, bool]:
    """Return when the frame was taken on the robot's clock, and whether that is the camera's own stamp."""
    if stamp_s is None:
        return arrived.robot_s, False
    for clock_s, is_stamped in ((arrived.wall_s, True), (arrived.steady_s, False)):
        age_s = clock_s - stamp_s
        if 0 <= age_s <= NEAR_S:
            return arrived.robot_s - age_s, is_stamped
    return arrived.robot_s, False

"""When a camera took a frame, on the robot's clock: by its own stamp if that is near, else by the frame's arrival."""

from __future__ import annotations

import time
from dataclasses import dataclass

from robotether_agent.clock import robot_time
from robotether_agent.fields import JsonObject, number_in
from robotether_agent.problems import DetailError

# Maximum age of a frame's timestamp; an older one is of another clock than this robot's.
NEAR_S = 10.0
# Time limit by which frames that must all come may come later than the quickest did: more is a queue on the way.
MAX_LAG_S = 1.0


class FramesLateError(DetailError):
    """A camera's frames queue on the way to the agent."""


@dataclass(frozen=True)
class ClockReadings:
    """One time on three clocks: since the robot's start, in Unix time, and CLOCK_MONOTONIC."""

    robot_s: float
    wall_s: float
    steady_s: float


def now() -> ClockReadings:
    """Look at the three clocks."""
    return ClockReadings(robot_time(), time.time(), time.clock_gettime(time.CLOCK_MONOTONIC))


def timestamp_of(stamp_s: float | None, arrived: ClockReadings) -> tuple[float, bool]:
    """Return when the frame was taken on the robot's clock, and whether that is the camera's own stamp."""
    if stamp_s is None:
        return arrived.robot_s, False
    for clock_s, is_stamped in ((arrived.wall_s, True), (arrived.steady_s, False)):
        age_s = clock_s - stamp_s
        if 0 <= age_s <= NEAR_S:
            return arrived.robot_s - age_s, is_stamped
    return arrived.robot_s, False


def stamp_of(message: JsonObject) -> float | None:
    """Return a message's stamp in seconds, as ROS 1 (secs, nsecs) and ROS 2 (sec, nanosec) write it; 0 is none.

    It is the header's, or `timestamp` as of foxglove_msgs.
    """
    header = message.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else message.get("timestamp")
    if not isinstance(stamp, dict):
        return None
    for whole, part in (("sec", "nanosec"), ("secs", "nsecs")):
        seconds, nanoseconds = number_in(stamp, whole), number_in(stamp, part)
        if seconds is not None and nanoseconds is not None:
            return seconds + nanoseconds / 1e9 or None
    return None


class FrameClock:
    """When a source's frames were taken; notices when they queue on the way, and when one is published again."""

    def __init__(self, max_lag_s: float = NEAR_S) -> None:
        """`max_lag_s` is by how much frames may come later than the quickest did."""
        self._max_lag_s = max_lag_s
        self._least_age_s: float | None = None
        # The newest frame's stamp and content, and when it was taken.
        self._newest: tuple[float | None, object] = None, None
        self._newest_taken = 0.0, False

    def timestamp(
        self, stamp_s: float | None, arrived: ClockReadings, content: object
    ) -> tuple[float, bool]:
        """Return what `timestamp_of` does; FramesLateError before what is old could look new.

        A frame with stamp and content of the one before is that one: a node whose camera is dead publishes it again.
        """
        if stamp_s is None or (stamp_s, content) != self._newest:
            self._newest_taken = self._taken(stamp_s, arrived)
            self._newest = stamp_s, content
        return self._newest_taken

    def _taken(self, stamp_s: float | None, arrived: ClockReadings) -> tuple[float, bool]:
        timestamp_s, is_stamped = timestamp_of(stamp_s, arrived)
        if is_stamped:
            age_s = arrived.robot_s - timestamp_s
            if self._least_age_s is None or age_s < self._least_age_s:
                self._least_age_s = age_s
            is_late = age_s - self._least_age_s > self._max_lag_s
        else:
            # After stamps of this robot's clock it is no other clock's.
            was_stamped = self._least_age_s is not None
            is_late = was_stamped and stamp_s is not None and stamp_s < arrived.wall_s
        if is_late:
            raise FramesLateError(f"its frames come over {self._max_lag_s:g} s later than they did")
        return timestamp_s, is_stamped

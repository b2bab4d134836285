"""What a stretch of looks at a connection says of its path: a round of any traffic, or one frame that goes by itself.

Pure; made and asked by the estimator.
"""

from __future__ import annotations

from math import sqrt

from robotether_agent.video.connection_state import Reading

MIN_ROUND_S = 0.04
# A round says what the path takes if somebody waited for the window during this part of it.
FULL_PART = 0.8
# Fewer segments are no frame. The last byte's arrival is seen so much too late, as often as one looks.
MIN_BURST_SEGMENTS = 4
SEEN_LATE_S = 0.004


class Round:
    """What was seen since `first`, until all that was under way then has arrived."""

    def __init__(self, first: Reading) -> None:
        self._first = first
        self._last = first
        self._full_s = 0.0
        self._rtt_sum = self._rtt_square_sum = 0.0

    def add(self, reading: Reading, *, was_full: bool) -> None:
        """Note one reading; each counts for the time since the one before."""
        since_s = reading.at_s - self._last.at_s
        self._full_s += since_s if was_full else 0.0
        self._rtt_sum += since_s * reading.rtt_s
        self._rtt_square_sum += since_s * reading.rtt_s**2
        self._last = reading

    @property
    def is_over(self) -> bool:
        """Whether it says something of the path."""
        has_lasted = self.lasted_s >= max(MIN_ROUND_S, self._last.rtt_s)
        return has_lasted and self._last.arrived >= self._first.written

    @property
    def lasted_s(self) -> float:
        """Its length in seconds."""
        return self._last.at_s - self._first.at_s

    @property
    def rate(self) -> float:
        """Bytes a second that arrived."""
        return (self._last.arrived - self._first.arrived) / self.lasted_s

    @property
    def rtt_s(self) -> float:
        """The mean round trip."""
        return self._rtt_sum / self.lasted_s

    @property
    def jitter_s(self) -> float:
        """The standard deviation of the round trips."""
        return sqrt(max(0.0, self._rtt_square_sum / self.lasted_s - self.rtt_s**2))

    @property
    def was_full(self) -> bool:
        """Whether the window was what held video back."""
        return self._full_s > FULL_PART * self.lasted_s


class Burst:
    """What is handed on until nobody wants to send any more, which is a frame mostly, and how fast it goes."""

    def __init__(self, first: Reading) -> None:
        self._first = first
        self._end = first.written

    def add(self, reading: Reading, *, is_handed: bool) -> None:
        """Note one reading; `is_handed`: all that anybody wanted to send by then was written."""
        if self._bytes or not is_handed:
            return
        # Less than before: the kernel is asked twice for a reading, and something arrived in between.
        if reading.written <= self._first.written:
            self._first = reading
        self._end = reading.written

    def has_arrived(self, reading: Reading) -> bool:
        """Whether the other end has all of it."""
        return self._bytes > 0 and reading.arrived >= self._end

    def rate(self, reading: Reading) -> float | None:
        """Return the bytes a second that the path took, now that it has arrived; nothing if it was too little to tell.

        Rather too few than too many: what was under way before went first.
        """
        if self._bytes < MIN_BURST_SEGMENTS * reading.segment:
            return None
        lasted_s = reading.at_s - self._first.at_s - reading.min_rtt_s - SEEN_LATE_S
        return self._bytes / max(lasted_s, SEEN_LATE_S)

    @property
    def _bytes(self) -> int:
        """What all of it is; 0 as long as that is not known."""
        return self._end - self._first.written

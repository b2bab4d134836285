"""Estimates how many bytes of video may be in flight without a queue on the path.

A pure model without clock and socket, fed by the pacer. The kernel's own congestion control (cubic, mostly) fills the
queue of the slowest link until it overflows, and control waits behind that. This keeps `rate x (round trip + QUEUE_S)`
bytes under way, both measured over rounds of at least a round trip:

* rate: what arrived in a round, the best of the last few. Since a little more than the path holds is under way,
  this grows by itself, round by round, as long as the path takes more. On a path that takes more than the camera
  gives, rounds have pauses in them and say too little; there each frame counts, from its first byte's way out to
  its last one's arrival, less the round trip that even a single byte takes.
* round trip without a queue: the shortest of the last BASE_FOR_S. After the start, when none as short was seen
  for that long and no pause between two frames either, or when a queue stays whatever we do, the window is halved
  for some rounds. That empties our part of any queue; what a round trip takes then is the path's own length, or the
  queue of somebody who does not give way. Where round trips differ by themselves, as on mobile networks, the
  shortest is a matter of luck: their deviation is added.
* a queue longer than CEILING_S means that the path has become slower or that others use it: only the newest
  round counts then. So video gives way to every other transfer, and never below SEGMENTS_MIN segments under way.
"""

from __future__ import annotations

from collections import deque
from math import sqrt
from typing import NamedTuple

MIN_ROUND_S = 0.04
# Minimum part of a round during which a sender waited for the window, so that the round measures
# the path.
FULL_PART = 0.8
# Minimum number of segments of a frame, and the delay of one check with which its last byte is
# noticed.
MIN_BURST_SEGMENTS = 4
SEEN_LATE_S = 0.004
# Length of the queue that keeps the link busy between two checks, and of the one that shows that
# the estimate is too high.
QUEUE_S = 0.006
CEILING_S = 0.015
BASE_FOR_S = 10.0
# Difference between round trips that has no meaning.
BASE_NOISE_S = 0.001
DRAIN_ROUNDS = 4
DRAIN_PAUSE_S = 3.0
# Part of the path's capacity below which no queue of ours hides the path's length after a frame.
PAUSE_PART = 0.8
# Number by which rounds with a queue must exceed those without one before the queue counts as
# lasting.
LASTING_ROUNDS = 8
MAX_ROUNDS = 8
SEGMENTS_AT_START = 10
MIN_SEGMENTS = 4
MAX_WINDOW = 4 * 1024 * 1024
# Time for which the line counts as full after the window held senders back for a round.
FULL_FOR_S = 5.0
# Gain of the window per round at the start, until rounds bring less than START_GROWTH or a queue
# appears.
START_GAIN = 2.0
START_GROWTH = 1.25
MAX_FLAT_ROUNDS = 3
# Gain of the window per round later, while there is no queue.
SEARCH_GAIN = 1.15
# Maximum ratio of the sending rate to the path's: a burst is a short queue, too.
SPEED_GAIN = 1.25


class Reading(NamedTuple):
    """One look at a connection; the two counts of bytes are of everything since it was made."""

    at_s: float
    # Bytes that the process wrote, and those of them that the other end has.
    written: int
    arrived: int
    # Smoothed over the last round trips, and the shortest of the last minutes.
    rtt_s: float
    min_rtt_s: float
    segment: int

    @property
    def in_flight(self) -> int:
        """Bytes that wait in the kernel or are in the network."""
        return self.written - self.arrived


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
        """Return the bytes a second that the path took, now that it has arrived; nothing if it was too little to know.

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


class BandwidthEstimator:
    """The estimate for one connection."""

    def __init__(self, first: Reading) -> None:
        self.queue_s = 0.0
        self._jitter_s = 0.0
        self._base_s = first.min_rtt_s
        self._base_seen_at = self._drained_at = first.at_s
        self._rates: deque[float] = deque(maxlen=MAX_ROUNDS)
        self._segment = first.segment
        self._round = Round(first)
        self._burst = Burst(first)
        self._start: Startup | None = Startup()
        self._drains_left = 0
        self._rounds_over_ceiling = 0
        self._full_at: float | None = None

    @property
    def window(self) -> int:
        """Bytes that may be under way now."""
        if not self._rates:
            return SEGMENTS_AT_START * self._segment
        held = self.rate * (self._base_s + QUEUE_S + self._jitter_s)
        return min(max(int(held * self._gain), MIN_SEGMENTS * self._segment), MAX_WINDOW)

    @property
    def rate(self) -> float:
        """Bytes a second that the path takes, as far as is known."""
        return max(self._rates, default=0.0)

    def full_rate(self, now_s: float) -> float | None:
        """Return the rate while senders fill the path; else nothing, as what they offer says little of it."""
        if self._full_at is None or now_s - self._full_at > FULL_FOR_S:
            return None
        return self.rate

    @property
    def speed(self) -> float:
        """Bytes a second at most at which the window may be filled."""
        if not self._rates:
            return float(MAX_WINDOW)
        least = MIN_SEGMENTS * self._segment / (self._base_s + QUEUE_S)
        return max(self.rate, least) * max(SPEED_GAIN, self._gain)

    @property
    def _gain(self) -> float:
        if self._drains_left:
            return 0.5
        if self._start is not None:
            return START_GAIN
        return SEARCH_GAIN if self._shows_no_queue else 1.0

    @property
    def _shows_no_queue(self) -> bool:
        return self.queue_s < QUEUE_S / 4

    def update(self, reading: Reading, *, was_full: bool, is_handed: bool) -> None:
        """Learn from `reading`; `was_full`: somebody has waited for the window since the last one.

        `is_handed`: nobody did, and all that was handed on before was written.
        """
        self._segment = reading.segment
        if is_handed and reading.in_flight < PAUSE_PART * self.rate * self._base_s:
            self._base_seen_at = reading.at_s
        self._burst.add(reading, is_handed=is_handed)
        if self._burst.has_arrived(reading):
            self._learn_burst(self._burst.rate(reading))
            self._burst = Burst(reading)
        self._round.add(reading, was_full=was_full)
        if self._round.is_over:
            self._learn(self._round, reading.at_s)
            self._round = Round(reading)

    def _learn(self, seen: Round, now_s: float) -> None:
        self._learn_base(seen, now_s)
        self.queue_s = max(0.0, seen.rtt_s - self._base_s)
        self._jitter_s += (min(seen.jitter_s, CEILING_S) - self._jitter_s) / MAX_ROUNDS
        if self._drains_left:
            self._drain(seen, now_s)
            return
        if seen.was_full and self._start is None:
            self._full_at = now_s
        # A camera that offered less says nothing of the path, unless it got more through than was thought.
        if seen.was_full or seen.rate > self.rate:
            self._judge_queue()
            self._learn_rate(seen.rate)
        if seen.was_full and self._base_is_doubtful(now_s):
            self._begin_drain()

    def _learn_burst(self, rate: float | None) -> None:
        if rate is None or self._drains_left:
            return
        # A lost segment makes a frame late on a path that is no slower; a slower one has a queue. A single frame
        # says less than a round, so that none of them is believed alone.
        if rate > self.rate or not self._shows_no_queue:
            self._learn_rate(rate)

    def _learn_base(self, seen: Round, now_s: float) -> None:
        if seen.rtt_s <= self._base_s + BASE_NOISE_S:
            self._base_seen_at = now_s
        self._base_s = min(self._base_s, seen.rtt_s)

    def _judge_queue(self) -> None:
        if self.queue_s > CEILING_S + self._jitter_s:
            self._rates.clear()
            self._rounds_over_ceiling += 1
        else:
            self._rounds_over_ceiling = max(0, self._rounds_over_ceiling - 1)

    def _learn_rate(self, rate: float) -> None:
        self._rates.append(rate)
        if self._start is not None and (self.queue_s > QUEUE_S or self._start.is_over(rate)):
            # The start may have made a queue. And only now full segments go, which take longer than what went before.
            self._begin_drain()

    def _base_is_doubtful(self, now_s: float) -> bool:
        if now_s - self._base_seen_at > BASE_FOR_S:
            return True
        has_paused = now_s - self._drained_at > DRAIN_PAUSE_S
        return has_paused and self._rounds_over_ceiling >= LASTING_ROUNDS

    def _begin_drain(self) -> None:
        self._start = None
        self._drains_left = DRAIN_ROUNDS

    def _drain(self, seen: Round, now_s: float) -> None:
        self._drains_left -= 1
        if not self._drains_left:
            self._base_s = seen.rtt_s
            self._base_seen_at = self._drained_at = now_s
            self._rounds_over_ceiling = 0


class Startup:
    """The first rounds of a connection, in which nothing is known of the path."""

    def __init__(self) -> None:
        self._best = 0.0
        self._rounds_without_growth = 0

    def is_over(self, rate: float) -> bool:
        """Learn the rate of another round, and return whether rounds bring no more any more."""
        if rate > self._best * START_GROWTH:
            self._best = rate
            self._rounds_without_growth = 0
        else:
            self._rounds_without_growth += 1
        return self._rounds_without_growth >= MAX_FLAT_ROUNDS

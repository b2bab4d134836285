"""Counts a drive: commanded distance, turn and speeds, messages, refusals, latency, frames.

Each drive has one; `observers` writes its entry while the drive lasts and at its end. A command counts until
the next, and no longer than the guard lets it: the robot stops by itself then. Pure: no clock of its own.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime

from robotether_server.db.control import DriveEntry
from robotether_server.relay.drives.viewer_stats import NOTHING, ViewerCounts

# Before the guard's kinds: some have the name of a kind of the policy's.
GUARD = "guard_"
MIN_LATENCY_MS, MAX_LATENCY_MS = 0.1, 60_000.0
LATENCY_STEP = math.log(1.02)


@dataclass(frozen=True)
class DriveCounters:
    """What others count while a drive lasts, as it stands now.

    Bytes that its connection passed; the robot's own round trip in ms, None: unknown; what the driver got of the
    robot's video, counted from any moment before the drive.
    """

    passed_bytes: Callable[[], int] = lambda: 0
    robot_rtt_ms: Callable[[], float | None] = lambda: None
    viewer_counts: Callable[[], ViewerCounts] = lambda: NOTHING


class DriveLog:
    """Keeps the books of one drive."""

    def __init__(
        self,
        entry: DriveEntry,
        deadman_s: float,
        refused: Counter[str],
        counters: DriveCounters = DriveCounters(),
    ) -> None:
        self.entry = entry
        self._counters = counters
        self._viewed_before = counters.viewer_counts()
        self._latency = LatencyHistogram()
        self._refused = refused
        self._refused_by_guard: Counter[str] = Counter()
        # None: it goes on.
        self.ended_s: float | None = None
        self._deadman_s = deadman_s
        # When the last command was sent, with its speeds.
        self._last = (0.0, 0.0, 0.0)

    def command(self, now: float, speed_m_s: float, turn_rad_s: float | None) -> None:
        """A command went to the robot."""
        entry, turn = self.entry, turn_rad_s or 0.0
        self._count_until(now)
        self._last = (now, speed_m_s, turn)
        entry.top_speed_m_s = max(entry.top_speed_m_s, speed_m_s)
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
        if robot_ms is not None:
            self._latency.add(driver_ms + robot_ms)

    def refused_by_guard(self, more: Mapping[str, int]) -> None:
        """The guard refused so many more messages, by kind; it may tell so after the drive's end."""
        self._refused_by_guard.update(more)

    def written(self) -> DriveEntry:
        """Return the entry as it stands."""
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
        entry.pictures, entry.picture_bytes = viewer_counts.frames, viewer_counts.bytes
        entry.viewed_s = round(viewer_counts.viewed_s, 3)
        entry.latency_p50_ms = self._latency.quantile(0.5)
        entry.latency_p95_ms = self._latency.quantile(0.95)

    def _count_until(self, now: float) -> None:
        at, speed, turn = self._last
        lasted_s = min(max(now - at, 0.0), self._deadman_s)
        self.entry.distance_m += speed * lasted_s
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
        """A round trip took so long."""
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

"""Counts a drive for its record, and frames, bytes and watching time of each user of one robot.

`channels/rosbridge/handler` makes a `DriveLog` for each drive, whose entry `observers` writes while it lasts and at
its end. `channels/video` counts what viewers get. Pure, except for a clock that is handed in.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime

from robotether_server.db.control import DriveEntry
from robotether_server.relay.robots.session_messages import Position, SeenReport

# Before the guard's kinds: some have the name of a kind of the policy's.
GUARD = "guard_"
MIN_LATENCY_MS, MAX_LATENCY_MS = 0.1, 60_000.0
LATENCY_STEP = math.log(1.02)


@dataclass(frozen=True)
class ViewerCounts:
    """Frames, the bytes of these frames, and the seconds in which at least one video was open."""

    frames: int = 0
    bytes: int = 0
    viewed_s: float = 0.0

    def since(self, earlier: ViewerCounts) -> ViewerCounts:
        """Return what came after `earlier`, which is an older count of the same."""
        return ViewerCounts(
            self.frames - earlier.frames,
            self.bytes - earlier.bytes,
            self.viewed_s - earlier.viewed_s,
        )


NOTHING = ViewerCounts()


@dataclass
class CameraCounts:
    """Frames that came from all cameras of one robot since the relay's start, and their bytes."""

    frames: int = 0
    bytes: int = 0


@dataclass
class _Viewer:
    frames: int = 0
    bytes: int = 0
    viewed_s: float = 0.0
    # Number of videos that are open, and since when there is one.
    open: int = 0
    open_since: float = 0.0


class ViewerStats:
    """The counts of one robot, by user."""

    def __init__(self) -> None:
        self._viewers: dict[int, _Viewer] = {}

    def count(self, user_id: int, size: int) -> None:
        """A frame of `size` bytes went to this user."""
        viewer = self._viewers.setdefault(user_id, _Viewer())
        viewer.frames += 1
        viewer.bytes += size

    @contextmanager
    def viewing(self, user_id: int) -> Iterator[None]:
        """Count the time inside the block as watched; blocks at the same time count once."""
        viewer = self._viewers.setdefault(user_id, _Viewer())
        if not viewer.open:
            viewer.open_since = time.monotonic()
        viewer.open += 1
        try:
            yield
        finally:
            viewer.open -= 1
            if not viewer.open:
                viewer.viewed_s += time.monotonic() - viewer.open_since

    def of(self, user_id: int) -> ViewerCounts:
        """Return what this user got of the robot since the relay's start."""
        viewer = self._viewers.get(user_id, _Viewer())
        open_s = time.monotonic() - viewer.open_since if viewer.open else 0.0
        return ViewerCounts(viewer.frames, viewer.bytes, viewer.viewed_s + open_s)


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

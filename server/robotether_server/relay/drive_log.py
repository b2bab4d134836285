"""What a drive came to: distance, turn and top speeds that were commanded, messages, refusals, latency, pictures.

Each drive has one; `reports` writes its entry while the drive lasts and at its end. A command counts until
the next, and no longer than the guard lets it: the robot stops by itself then. Pure: no clock of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime

from robotether_server.relay.deliveries import NOTHING, Delivered
from robotether_server.relay.latencies import Latencies
from robotether_server.store.control import DriveEntry

# Before the guard's kinds: some have the name of a kind of the policy's.
GUARD = "guard_"


@dataclass(frozen=True)
class Meters:
    """What others count while a drive lasts, as it stands now.

    Bytes that its connection passed; the robot's own round trip in ms, None: unknown; what the driver got of the
    robot's video, counted from any moment before the drive.
    """

    passed_bytes: Callable[[], int] = lambda: 0
    robot_rtt_ms: Callable[[], float | None] = lambda: None
    delivered: Callable[[], Delivered] = lambda: NOTHING


class DriveLog:
    """Keeps the books of one drive."""

    def __init__(
        self,
        entry: DriveEntry,
        deadman_s: float,
        refused: Counter[str],
        meters: Meters = Meters(),
    ) -> None:
        self.entry = entry
        self._meters = meters
        self._delivered_before = meters.delivered()
        self._latencies = Latencies()
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
        robot_ms = self._meters.robot_rtt_ms()
        if robot_ms is not None:
            self._latencies.add(driver_ms + robot_ms)

    def refused_by_guard(self, more: Mapping[str, int]) -> None:
        """The guard refused so many more messages, by kind; it may tell so after the drive's end."""
        self._refused_by_guard.update(more)

    def written(self) -> DriveEntry:
        """Return the entry as it stands."""
        if self.ended_s is None:
            self._read_meters()
        guards = {f"{GUARD}{kind}": count for kind, count in self._refused_by_guard.items()}
        self.entry.refused = dict(self._refused) | guards
        return self.entry

    def end(self, now: float, moment: datetime, code: str) -> DriveEntry:
        """Close the books."""
        self._count_until(now)
        # What comes from now on is not this drive's.
        self._read_meters()
        self._last, self.ended_s = (now, 0.0, 0.0), now
        self.entry.ended_at, self.entry.end_code = moment, code
        self.entry.stops = int(code == "robot_stopped")
        return self.written()

    def _read_meters(self) -> None:
        entry, meters = self.entry, self._meters
        delivered = meters.delivered().since(self._delivered_before)
        entry.bytes = meters.passed_bytes()
        entry.pictures, entry.picture_bytes = delivered.pictures, delivered.bytes
        entry.viewed_s = round(delivered.viewed_s, 3)
        entry.latency_p50_ms = self._latencies.quantile(0.5)
        entry.latency_p95_ms = self._latencies.quantile(0.95)

    def _count_until(self, now: float) -> None:
        at, speed, turn = self._last
        lasted_s = min(max(now - at, 0.0), self._deadman_s)
        self.entry.distance_m += speed * lasted_s
        self.entry.turned_rad += turn * lasted_s

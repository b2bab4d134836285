"""What a drive came to: distance, turn and top speeds that were commanded, messages and refusals.

Each drive has one; `reports` writes its entry while the drive lasts and at its end. A command counts until
the next, and no longer than the guard lets it: the robot stops by itself then. Pure: no clock of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from datetime import datetime

from robotether_server.store.control import DriveEntry

# Before the guard's kinds: some have the name of a kind of the policy's.
GUARD = "guard_"


class DriveLog:
    """Keeps the books of one drive."""

    def __init__(self, entry: DriveEntry, deadman_s: float, refused: Counter[str]) -> None:
        self.entry = entry
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

    def refused_by_guard(self, more: Mapping[str, int]) -> None:
        """The guard refused so many more messages, by kind; it may tell so after the drive's end."""
        self._refused_by_guard.update(more)

    def written(self) -> DriveEntry:
        """Return the entry as it stands."""
        guards = {f"{GUARD}{kind}": count for kind, count in self._refused_by_guard.items()}
        self.entry.refused = dict(self._refused) | guards
        return self.entry

    def end(self, now: float, moment: datetime, code: str) -> DriveEntry:
        """Close the books."""
        self._count_until(now)
        self._last, self.ended_s = (now, 0.0, 0.0), now
        self.entry.ended_at, self.entry.end_code = moment, code
        self.entry.stops = int(code == "robot_stopped")
        return self.written()

    def _count_until(self, now: float) -> None:
        at, speed, turn = self._last
        lasted_s = min(max(now - at, 0.0), self._deadman_s)
        self.entry.distance_m += speed * lasted_s
        self.entry.turned_rad += turn * lasted_s

"""Counts frames, bytes and watching time of each user and robot, for the records of drives.

`feeds` and `streams` count, `observers` reads at a drive's beginning and end. Numbers only grow while the relay
runs. No network; the clock is handed in.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

Key = tuple[int, int]


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


class ViewerStats:
    """The counts, by robot and user."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._frames: Counter[Key] = Counter()
        self._bytes: Counter[Key] = Counter()
        self._viewed_s: dict[Key, float] = {}
        # How many videos of a robot a user has open, and since when there is one.
        self._open: Counter[Key] = Counter()
        self._open_since: dict[Key, float] = {}

    def count(self, robot_id: int, user_id: int, size: int) -> None:
        """A frame of `size` bytes went to this user."""
        self._frames[robot_id, user_id] += 1
        self._bytes[robot_id, user_id] += size

    @contextmanager
    def viewing(self, robot_id: int, user_id: int) -> Iterator[None]:
        """Count the time inside the block as watched; blocks at the same time count once."""
        key = (robot_id, user_id)
        if not self._open[key]:
            self._open_since[key] = self._clock()
        self._open[key] += 1
        try:
            yield
        finally:
            self._open[key] -= 1
            if not self._open[key]:
                del self._open[key]
                viewed_s = self._clock() - self._open_since.pop(key)
                self._viewed_s[key] = self._viewed_s.get(key, 0.0) + viewed_s

    def of(self, robot_id: int, user_id: int) -> ViewerCounts:
        """Return what this user got of this robot since the relay's start."""
        key, now = (robot_id, user_id), self._clock()
        viewed_s = self._viewed_s.get(key, 0.0) + now - self._open_since.get(key, now)
        return ViewerCounts(self._frames[key], self._bytes[key], viewed_s)

"""Counts frames, bytes and watching time of each user of one robot, for the records of drives.

`feeds` and `streams` count, `observers` reads at a drive's beginning and end. Numbers only grow while the relay
runs. No network; the clock is handed in.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


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
    """The counts of one robot, by user."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._frames: Counter[int] = Counter()
        self._bytes: Counter[int] = Counter()
        self._viewed_s: defaultdict[int, float] = defaultdict(float)
        # How many videos a user has open, and since when there is one.
        self._open: Counter[int] = Counter()
        self._open_since: dict[int, float] = {}

    def count(self, user_id: int, size: int) -> None:
        """A frame of `size` bytes went to this user."""
        self._frames[user_id] += 1
        self._bytes[user_id] += size

    @contextmanager
    def viewing(self, user_id: int) -> Iterator[None]:
        """Count the time inside the block as watched; blocks at the same time count once."""
        if not self._open[user_id]:
            self._open_since[user_id] = self._clock()
        self._open[user_id] += 1
        try:
            yield
        finally:
            self._open[user_id] -= 1
            if not self._open[user_id]:
                del self._open[user_id]
                self._viewed_s[user_id] += self._clock() - self._open_since.pop(user_id)

    def of(self, user_id: int) -> ViewerCounts:
        """Return what this user got of the robot since the relay's start."""
        now = self._clock()
        viewed_s = self._viewed_s[user_id] + now - self._open_since.get(user_id, now)
        return ViewerCounts(self._frames[user_id], self._bytes[user_id], viewed_s)

"""Counts frames, bytes and watching time of each user of one robot, for the records of drives.

`feeds` and `streams` count, `observers` reads at a drive's beginning and end. Numbers only grow while the relay
runs. No network; the clock is handed in.
"""

from __future__ import annotations

import time
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

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
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
            viewer.open_since = self._clock()
        viewer.open += 1
        try:
            yield
        finally:
            viewer.open -= 1
            if not viewer.open:
                viewer.viewed_s += self._clock() - viewer.open_since

    def of(self, user_id: int) -> ViewerCounts:
        """Return what this user got of the robot since the relay's start."""
        viewer = self._viewers.get(user_id, _Viewer())
        open_s = self._clock() - viewer.open_since if viewer.open else 0.0
        return ViewerCounts(viewer.frames, viewer.bytes, viewer.viewed_s + open_s)

"""Counts who needs something of one robot, and remembers them for a while after they have left.

Each `Robot` has two: viewers need its media connection, and whoever is connected needs its quick heartbeats. Most
robots of a fleet are needed by nobody.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# Time limit for the media connection to open: for a log-in over the robot's network.
OPENS_WITHIN_S = 5.0
RETRY_S = 0.05


class Demand:
    """Counts who needs the robot; `changed` is called when the first comes, and a while after the last has left."""

    def __init__(self, changed: Callable[[], None], *, kept_s: float, always: bool) -> None:
        self._changed = changed
        self._always = always
        self._kept_s = kept_s
        self._count = 0
        self._timer: asyncio.TimerHandle | None = None

    @property
    def exists(self) -> bool:
        """Whether the robot is needed now."""
        return self._always or self._count > 0 or self._timer is not None

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count somebody who needs the robot inside the block."""
        existed = self.exists
        self.close()
        self._count += 1
        if not existed:
            self._changed()
        try:
            yield
        finally:
            self._count -= 1
            if self._count == 0:
                self._timer = asyncio.get_running_loop().call_later(self._kept_s, self._expire)

    def close(self) -> None:
        """Cancel the timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _expire(self) -> None:
        self._timer = None
        if not self.exists:
            self._changed()

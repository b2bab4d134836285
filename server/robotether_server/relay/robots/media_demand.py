"""Which robots need their media connection: those whose video somebody watches, or watched a short while ago.

Viewers of video count themselves in here; a robot's session link asks here what its configuration says. A connection
costs a login, memory and heartbeats at both ends, and most robots of a fleet are watched by nobody.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# A viewer waits so long for the connection to open: for a log-in over the robot's network.
OPENS_WITHIN_S = 5.0
RETRY_S = 0.05
# A page that is opened again, and the next look at the fleet, find it open.
KEPT_S = 300.0


class MediaDemand:
    """Counts the viewers of each robot; `changed` is called when a robot begins or ceases to need the connection."""

    def __init__(
        self, changed: Callable[[int], None], *, always: bool = False, kept_s: float = KEPT_S
    ) -> None:
        self._changed = changed
        self._always = always
        self._kept_s = kept_s
        self._viewers: Counter[int] = Counter()
        self._kept: dict[int, asyncio.TimerHandle] = {}

    def needs(self, robot_id: int) -> bool:
        """Return whether the robot needs its media connection now."""
        return self._always or robot_id in self._viewers or robot_id in self._kept

    @contextmanager
    def watched(self, robot_id: int) -> Iterator[None]:
        """Count a viewer of the robot's video inside the block."""
        needed = self.needs(robot_id)
        if (timer := self._kept.pop(robot_id, None)) is not None:
            timer.cancel()
        self._viewers[robot_id] += 1
        if not needed:
            self._changed(robot_id)
        try:
            yield
        finally:
            self._leave(robot_id)

    def close(self) -> None:
        """Forget all; the relay stops."""
        for timer in self._kept.values():
            timer.cancel()
        self._kept.clear()

    def _leave(self, robot_id: int) -> None:
        self._viewers[robot_id] -= 1
        if not self._viewers[robot_id]:
            del self._viewers[robot_id]
            loop = asyncio.get_running_loop()
            self._kept[robot_id] = loop.call_later(self._kept_s, self._let_go, robot_id)

    def _let_go(self, robot_id: int) -> None:
        del self._kept[robot_id]
        if not self.needs(robot_id):
            self._changed(robot_id)

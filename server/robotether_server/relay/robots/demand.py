"""Counts who needs something of each robot, and remembers them for a while after they have left.

`main` makes two. Viewers of video need the robot's media connection, which costs a login, memory and heartbeats at both
ends. Whoever is connected to a robot needs its quick heartbeats. Most robots of a fleet are needed by nobody.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# A viewer waits so long for the connection to open: for a log-in over the robot's network.
OPENS_WITHIN_S = 5.0
RETRY_S = 0.05
# A page that is opened again, and the next look at the fleet, find the media connection open.
MEDIA_KEPT_S = 300.0
# A page that is loaded again changes nothing.
USE_KEPT_S = 10.0


class Demand:
    """Counts who needs each robot; `changed` is called when the first comes, and a while after the last has left."""

    def __init__(
        self, changed: Callable[[int], None], *, kept_s: float, always: bool = False
    ) -> None:
        self._changed = changed
        self._always = always
        self._kept_s = kept_s
        self._count: Counter[int] = Counter()
        self._kept: dict[int, asyncio.TimerHandle] = {}

    def of(self, robot_id: int) -> bool:
        """Return whether the robot is needed now."""
        return self._always or robot_id in self._count or robot_id in self._kept

    @contextmanager
    def counted(self, robot_id: int) -> Iterator[None]:
        """Count somebody who needs the robot inside the block."""
        needed = self.of(robot_id)
        if (timer := self._kept.pop(robot_id, None)) is not None:
            timer.cancel()
        self._count[robot_id] += 1
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
        self._count[robot_id] -= 1
        if not self._count[robot_id]:
            del self._count[robot_id]
            loop = asyncio.get_running_loop()
            self._kept[robot_id] = loop.call_later(self._kept_s, self._let_go, robot_id)

    def _let_go(self, robot_id: int) -> None:
        del self._kept[robot_id]
        if not self.of(robot_id):
            self._changed(robot_id)

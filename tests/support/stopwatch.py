"""Time in which the machine let this process run: what a test's upper limit is about."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Self

TICK_S = 0.005
# Who wants to go on after one tick waits longer only while the process stands still.
GOES_ON_WITHIN_S = 0.025


class Stopwatch:
    """Counts as long as the `with` block.

    A machine shared with others stands still for half a second now and then, and code that waits for nothing
    looks slow meanwhile. A thread beside the test sees such a pause as one long tick, of which the first
    GOES_ON_WITHIN_S count. A loop that is held up, by a call that blocks or by work, stops no other thread and
    counts in full. A lower limit asks the clock.
    """

    def __init__(self) -> None:
        self._counted_s = 0.0
        self._last_s = 0.0
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._last_s = time.monotonic()
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._count()
        self._over.set()
        self._thread.join()

    @property
    def s(self) -> float:
        """Seconds since the block began, or that it lasted."""
        if not self._over.is_set():
            self._count()
        return self._counted_s

    def _run(self) -> None:
        while not self._over.wait(TICK_S):
            self._count()

    def _count(self) -> None:
        with self._lock:
            now = time.monotonic()
            self._counted_s += min(now - self._last_s, GOES_ON_WITHIN_S)
            self._last_s = now

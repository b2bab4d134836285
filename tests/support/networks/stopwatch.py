"""Time in which the machine let this process run: what a test's upper limit is about."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Self

TICK_S = 0.005
# Who wants to go on after one tick waits longer only while the process stands still.
GOES_ON_WITHIN_S = 0.025


class Stopwatch:
    """Counts as long as the `with` block.

    A machine shared with others stands still for half a second now and then, and code that waits for nothing
    looks slow meanwhile. A thread beside the test sees such a pause as one long tick, of which the first
    GOES_ON_WITHIN_S count. A loop that is held up, by a call that blocks or by work, stops no other thread and
    counts in full; so does work that lets no other thread run, by the processor time that it takes. Nothing counts
    while other programs have the processor that this thread waits for.
    Upper limits are for `s`, lower ones for `clock_s`.
    """

    def __init__(self) -> None:
        self._counted_s = 0.0
        self._began_s = self._last_s = 0.0
        self._last_cpu_s = self._last_queued_s = 0.0
        # What the thread waited for a processor in ticks that were counted.
        self._uncounted_s = 0.0
        self._schedstat = Path(f"/proc/self/task/{threading.get_native_id()}/schedstat")
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._began_s = self._last_s = time.monotonic()
        self._last_cpu_s, self._last_queued_s = time.process_time(), self._queued_s()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._count()
        self._over.set()
        self._thread.join()

    @property
    def s(self) -> float:
        """Seconds since the block began, or that it lasted, without the machine's pauses."""
        if not self._over.is_set():
            self._count()
        return self._counted_s

    @property
    def clock_s(self) -> float:
        """The same with them."""
        if not self._over.is_set():
            self._count()
        return self._last_s - self._began_s

    def _run(self) -> None:
        while not self._over.wait(TICK_S):
            self._count()

    def _count(self) -> None:
        with self._lock:
            now, cpu_s, queued_s = time.monotonic(), time.process_time(), self._queued_s()
            worked_s = cpu_s - self._last_cpu_s
            ticked_s = now - self._last_s
            lasted_s = min(ticked_s, max(GOES_ON_WITHIN_S, worked_s))
            # The kernel notes it once the thread has a processor, which may be some ticks later.
            self._uncounted_s += queued_s - self._last_queued_s - (ticked_s - lasted_s)
            self._uncounted_s = max(0.0, self._uncounted_s)
            paused_s = min(self._uncounted_s, lasted_s)
            self._uncounted_s -= paused_s
            self._counted_s += lasted_s - paused_s
            self._last_s, self._last_cpu_s, self._last_queued_s = now, cpu_s, queued_s

    def _queued_s(self) -> float:
        """How long the thread has waited for a processor since it began."""
        _, waited_ns, _ = self._schedstat.read_text().split()
        return int(waited_ns) / 1e9

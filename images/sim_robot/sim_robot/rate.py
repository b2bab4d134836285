"""Calls a function at a fixed rate that does not drift, and says so when it cannot.

Used by simulator.py for the 62.5 Hz loop. Deadlines are multiples of the period from the start, so that
a late call does not move the following ones; missed calls are made up, up to a limit.
"""

import asyncio
import logging
from collections.abc import Callable

log = logging.getLogger(__name__)

LATE_LIMIT_S = 0.25
WARN_EVERY_S = 10.0


class FixedRate:
    """Calls `action` every `period_s` seconds until its task is cancelled."""

    def __init__(self, period_s: float, action: Callable[[], None]) -> None:
        self._period_s = period_s
        self._action = action
        self.calls = 0
        self.skipped = 0

    async def run(self) -> None:
        """Run for ever."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time()
        warn_at_s = deadline_s
        while True:
            deadline_s += self._period_s
            # Also when late: others get their turn between two calls that are made up.
            await asyncio.sleep(max(deadline_s - loop.time(), 0.0))
            late_s = loop.time() - deadline_s
            if late_s > LATE_LIMIT_S:
                deadline_s += self._skip(late_s)
                if loop.time() >= warn_at_s:
                    warn_at_s = loop.time() + WARN_EVERY_S
                    self._warn(late_s)
            self._action()
            self.calls += 1

    def _skip(self, late_s: float) -> float:
        missed = int(late_s / self._period_s)
        self.skipped += missed
        return missed * self._period_s

    def _warn(self, late_s: float) -> None:
        log.warning(
            "cannot hold %.1f Hz: was %.0f ms late, %d steps skipped since the start;"
            " give this robot more processor time",
            1 / self._period_s,
            late_s * 1000,
            self.skipped,
        )

"""How long round trips took: p50, p95 and the like of any number of them, in bounded memory.

Each drive's books have one (`drive_log`). Times are counted in steps that grow by 2 %, so that a quantile is
within 1 % of what was measured. Pure.
"""

from __future__ import annotations

import math
from collections import Counter

MIN_MS, MAX_MS = 0.1, 60_000.0
STEP = math.log(1.02)


class LatencyHistogram:
    """Round trips, by how long they took. What is shorter or longer than the bounds counts as these."""

    def __init__(self) -> None:
        # At most some 670 steps lie between the bounds.
        self._counts: Counter[int] = Counter()

    def add(self, ms: float) -> None:
        """A round trip took so long."""
        bounded = min(max(ms, MIN_MS), MAX_MS)
        self._counts[round(math.log(bounded) / STEP)] += 1

    def quantile(self, share: float) -> float | None:
        """Return in ms the time within which this share of all came back; None: there was none."""
        rank = math.ceil(share * self._counts.total())
        for step in sorted(self._counts):
            rank -= self._counts[step]
            if rank <= 0:
                return round(math.exp(step * STEP), 1)
        return None

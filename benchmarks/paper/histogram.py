"""Times in ms as they are told between processes and kept: how often which was seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray


class Histogram:
    """How often which time was seen; a time is kept to 0.01 ms, from 100 ms on to four digits."""

    def __init__(self, kept: Mapping[str, int] | None = None) -> None:
        # By ms as text, as JSON carries it.
        self._counts = Counter(kept or {})

    @classmethod
    def merged(cls, parts: Iterable[Mapping[str, int]]) -> Histogram:
        """Of several, as `as_json` made them."""
        return cls(sum(map(Counter, parts), Counter()))

    def add(self, ms: float) -> None:
        """Note one time in ms, which is not negative."""
        self._counts[f"{ms if ms < 100 else float(f'{ms:.4g}'):.2f}"] += 1

    def as_json(self) -> dict[str, int]:
        return dict(self._counts)

    @property
    def total(self) -> int:
        return self._counts.total()

    @property
    def times_ms(self) -> NDArray[np.float64]:
        return np.repeat(np.array(list(self._counts), dtype=float), list(self._counts.values()))

    def quantile_ms(self, part: float) -> float | None:
        """The time that `part` (0 to 1) of them stay below or reach; None where none is."""
        return float(np.quantile(self.times_ms, part)) if self.total else None

"""What a LeRobot dataset says of each feature: least, greatest, mean, spread and quantiles, of an episode and of all.

As `lerobot.datasets.compute_stats` has them: of images per channel, from 0 to 1, of some frames made smaller.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Statistics = dict[str, Any]
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
# Of an episode's frames this number counts, or more of a long one.
MIN_SAMPLES, SAMPLES_POWER = 100, 0.75
# Sides of a frame from which it is made smaller, and to about which.
LARGE_SIDE, SMALL_SIDE = 300, 150
LEVELS = 256


def describe(rows: NDArray[Any]) -> Statistics:
    """Return the statistics of each column of `rows` (n, columns)."""
    values = rows.astype(np.float64)
    quantiles = np.quantile(values, QUANTILES, axis=0)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
        **_named(quantiles.tolist()),
    }


def sampled_steps(length: int) -> frozenset[int]:
    """Return which steps of an episode count for the statistics of its images."""
    count = min(length, max(MIN_SAMPLES, int(length**SAMPLES_POWER)))
    return frozenset(np.linspace(0, length - 1, count).round().astype(int).tolist())


class ImageStatistics:
    """Counts how often each level of each channel comes."""

    def __init__(self) -> None:
        self._counts = np.zeros((3, LEVELS), np.int64)
        self._images = 0

    def add(self, image: NDArray[np.uint8]) -> None:
        """Count an image (height, width, 3)."""
        height, width, _ = image.shape
        longest = max(height, width)
        every = longest // SMALL_SIDE if longest >= LARGE_SIDE else 1
        small = image[::every, ::every]
        for channel in range(3):
            self._counts[channel] += np.bincount(small[..., channel].ravel(), minlength=LEVELS)
        self._images += 1

    def add_all(self, other: ImageStatistics) -> None:
        """Count what another one counted."""
        self._counts += other._counts
        self._images += other._images

    def describe(self) -> Statistics:
        """Return the statistics, each (3, 1, 1) from 0 to 1 but the number of images."""
        levels = np.arange(LEVELS) / (LEVELS - 1)
        shares = self._counts / self._counts.sum(axis=1, keepdims=True)
        means = shares @ levels
        reached = shares.cumsum(axis=1)
        quantiles = [[levels[np.searchsorted(row, q)] for row in reached] for q in QUANTILES]
        present = [np.flatnonzero(row) for row in self._counts]
        figures = {
            "min": [levels[row[0]] for row in present],
            "max": [levels[row[-1]] for row in present],
            "mean": means,
            "std": np.sqrt(np.maximum(shares @ levels**2 - means**2, 0)),
            **_named(quantiles),
        }
        shaped = {name: [[[float(value)]] for value in each] for name, each in figures.items()}
        return {**shaped, "count": [self._images]}


def _named(quantiles: list[Any]) -> dict[str, Any]:
    return {f"q{round(q * 100):02d}": each for q, each in zip(QUANTILES, quantiles, strict=True)}

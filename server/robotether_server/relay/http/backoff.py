"""Delays between attempts; a generator, tested without a network."""

from __future__ import annotations

from collections.abc import Iterator


def delays(first_s: float = 0.5, max_s: float = 5.0, factor: float = 2.0) -> Iterator[float]:
    """Yield seconds to wait before the second, third, ... try."""
    delay = first_s
    while True:
        yield delay
        delay = min(delay * factor, max_s)

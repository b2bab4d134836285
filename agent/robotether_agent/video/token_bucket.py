"""Two counts for the pacer, as pure models: what ssh was handed and did not write yet, and what more it may get."""

from __future__ import annotations

from robotether_agent.video.connection_state import Reading

# ssh takes at once what it can send. What it has not written by then is stuck at a viewer who takes nothing,
# and must not count against the others.
STUCK_AFTER_S = 0.25
# What may have gathered while nobody wanted to send.
SAVED_S = 0.012


class UnwrittenBytes:
    """The bytes that were handed to ssh and that it has not written to its connection yet."""

    def __init__(self) -> None:
        self._bytes = 0
        self._since: Reading | None = None

    def add(self, count: int) -> None:
        """Note that `count` bytes go to ssh now."""
        self._bytes += count

    def left(self, reading: Reading) -> int:
        """Return how many of them ssh still has; ssh's own additions are too few to matter between two zeros."""
        if self._since is None:
            self._since = reading
        left = self._bytes - (reading.written - self._since.written)
        if left <= 0 or reading.at_s - self._since.at_s > STUCK_AFTER_S:
            self._bytes, self._since = 0, reading
            return 0
        return left


class TokenBucket:
    """The bytes that time has brought and nobody has taken."""

    def __init__(self, now_s: float, saved: int) -> None:
        self._now_s = now_s
        self._saved = float(saved)

    def fill(self, now_s: float, speed: float, *, has_waited: bool, least: int) -> int:
        """Add what `speed` bytes a second bring until `now_s`; return what is there.

        While somebody waits nothing is lost, however late a look comes; else no more than SAVED_S or `least` is kept.
        """
        self._saved += speed * (now_s - self._now_s)
        self._now_s = now_s
        if not has_waited:
            self._saved = min(self._saved, max(speed * SAVED_S, float(least)))
        return int(self._saved)

    def consume(self, count: int) -> None:
        """Note that `count` bytes go."""
        self._saved -= count

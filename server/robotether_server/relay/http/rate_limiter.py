"""Token buckets: so many a second on average, and some at once.

`robot_link` keeps one for the lines of a robot, a `MessageValidator` for the messages of a client, for the
answers to them and for what it refuses, a `Lease` for the questions of each user. Pure: no network, no clock
of its own.
"""

from __future__ import annotations


class RateLimiter:
    """A token bucket."""

    def __init__(self, now: float, *, per_s: float, at_once: int) -> None:
        self._per_s = per_s
        self._capacity = at_once
        self._tokens = float(at_once)
        self._filled_at = now

    def allow(self, now: float, count: int = 1) -> bool:
        """Use the allowance so many times; False, and nothing is used, when there is not enough left."""
        filled = self._tokens + (now - self._filled_at) * self._per_s
        self._filled_at = now
        self._tokens = min(filled, self._capacity)
        if self._tokens < count:
            return False
        self._tokens -= count
        return True

    def free_in_s(self, now: float, count: int = 1) -> float:
        """How long until it may be used so many times."""
        left = min(self._tokens + (now - self._filled_at) * self._per_s, self._capacity)
        return max(0.0, (count - left) / self._per_s)


class Excess:
    """Notices who goes on beyond a rate for some seconds; a burst, however large, is not that."""

    def __init__(self, now: float, *, per_s: float, for_s: float) -> None:
        self._for_s = for_s
        self._capacity = max(1, int(per_s * for_s))
        self._reserve = RateLimiter(now, per_s=per_s, at_once=self._capacity)
        self._since = now

    def add(self, now: float, count: int) -> bool:
        """Count so many; tell whether the rate has been exceeded for long enough."""
        if not self._reserve.free_in_s(now, self._capacity):
            self._since = now
        in_reserve = self._reserve.allow(now, min(count, self._capacity))
        return not in_reserve and now - self._since >= self._for_s

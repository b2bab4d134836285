"""Frames a second: how many go on, evenly, and how many went. Never reads a clock: each moment is an argument."""

from __future__ import annotations

from collections import deque

# Saved up for jitter: a camera of just the wanted rate comes early as often as late.
MAX_SAVED = 2.0


class FrameRateLimiter:
    """Lets `fps` frames a second through, spread evenly over those that come."""

    def __init__(self, fps: float) -> None:
        self.fps = fps
        self._saved = MAX_SAVED
        self._at_s: float | None = None

    def allows(self, now_s: float) -> bool:
        """Tell whether the frame that came now goes on."""
        if self._at_s is not None:
            gained = max(0.0, now_s - self._at_s) * self.fps
            self._saved = min(MAX_SAVED, self._saved + gained)
        self._at_s = now_s
        if self._saved < 1:
            return False
        self._saved -= 1
        return True


class FrameRateCounter:
    """How many came in a second, of the last `over_s` seconds."""

    def __init__(self, over_s: float = 2.0) -> None:
        self._over_s = over_s
        self._times: deque[float] = deque(maxlen=256)

    def note(self, now_s: float) -> None:
        """Count one."""
        self._times.append(now_s)

    def rate(self, now_s: float) -> float:
        """Return how many a second."""
        while self._times and self._times[0] <= now_s - self._over_s:
            self._times.popleft()
        return len(self._times) / self._over_s

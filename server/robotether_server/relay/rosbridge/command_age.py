"""How old a driver's command is at least... and so at most: the earliest moment at which it can have been.

A driver's bridge has one. A client that stamps its commands says the moment itself, on our clock as its
beats tell it; of another one it is known that a message behind a pong is younger than that pong's ping.
Moments are seconds of time.monotonic(). Pure: no network, no clock of its own.
"""

from __future__ import annotations

import struct
from collections import deque

# Pings may be unanswered as long as a silent client is waited for; of more, the oldest are forgotten.
MAX_PINGS_OPEN = 64
# Two clocks drift apart by less between beats; some browsers round theirs to 0.1 s.
AHEAD_S = 0.25
_SEQUENCE = struct.Struct("!Q")


class CommandTimestamps:
    """What the pongs of one connection say about the messages behind them."""

    def __init__(self, opened_at: float) -> None:
        # Nothing can have been sent before the connection was open.
        self._earliest = opened_at
        self._sequence = 0
        self._open: deque[tuple[int, float]] = deque(maxlen=MAX_PINGS_OPEN)

    def ping(self, now: float) -> bytes:
        """Return the payload of a ping that is sent now."""
        self._sequence += 1
        self._open.append((self._sequence, now))
        return _SEQUENCE.pack(self._sequence)

    def pong(self, payload: bytes) -> float | None:
        """A pong came; return when its ping was sent. None: it answers none of our open pings, and says nothing."""
        if len(payload) != _SEQUENCE.size:
            return None
        (sequence,) = _SEQUENCE.unpack(payload)
        if not any(sequence == each for each, _ in self._open):
            return None
        while self._open and self._open[0][0] <= sequence:
            _, self._earliest = self._open.popleft()
        return self._earliest

    def of(self, stamp_ms: float | None, now: float) -> float | None:
        """Return the earliest moment of a command that came now; None: it says one that is to come."""
        if stamp_ms is None:
            return self._earliest
        # Such a client's clock is wrong, or ours stood still: its commands would never grow old.
        return None if stamp_ms / 1000 > now + AHEAD_S else min(stamp_ms / 1000, now)

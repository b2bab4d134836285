"""How many frames of a feed its robot may send before a viewer has taken those that came; pure.

Two, and as many as come in the time that a grant and its frame are on their way at least. With fewer the way would
bound their rate; with more, old frames would wait where the line is full.
"""

from __future__ import annotations

from collections import deque

from robotether_common.frames import CREDITS, MAX_CREDITS

from robotether_server.problems import ProtocolError

# Maximum interval between frames, and weight of the last one.
MAX_INTERVAL_S, WEIGHT = 1.0, 0.1
# Part of an encoded frame on the way that counts as one. A JPEG must be there whole: JPEGs fill lines.
NEARLY = 0.75


class Credits:
    """The books of one feed; numbers are the feed's own."""

    def __init__(self) -> None:
        # The newest frame that a viewer took, None on a new connection.
        self.taken: int | None = None
        self._open = 0
        self._untaken: deque[int] = deque()
        self._last_s = 0.0
        self._part = 1.0
        self._interval_s = MAX_INTERVAL_S

    def restart(self) -> None:
        """There is a new connection, on which none is open."""
        self._open = 0
        self.forget()

    def forget(self) -> None:
        """Who left did not take what came last: it says nothing of the line, and holds up no other frame."""
        self._untaken.clear()
        self.taken = None

    def grant(self, way_s: float) -> int:
        """Return how many more frames the robot may send now; `way_s` is the shortest time there and back."""
        window = min(MAX_CREDITS, CREDITS + int(way_s / self._interval_s + 1 - self._part))
        frames = max(0, window - self._open - len(self._untaken))
        self._open += frames
        return frames

    def on_frame(self, now_s: float, *, is_encoded: bool) -> None:
        """A frame came; ProtocolError when none was open."""
        if not self._open:
            raise ProtocolError("more frames came than were requested")
        self._open -= 1
        self._part = NEARLY if is_encoded else 1.0
        passed_s = min(MAX_INTERVAL_S, now_s - self._last_s)
        self._interval_s += WEIGHT * (passed_s - self._interval_s)
        self._last_s = now_s

    def await_taken(self, sequence: int) -> None:
        """Keep the robot from another frame until this one is taken."""
        self._untaken.append(sequence)

    def on_taken(self, sequence: int) -> bool:
        """A viewer took a frame, and with it those before; return whether it is the first to do so."""
        if sequence not in self._untaken:
            return False
        self.taken = sequence
        while self._untaken.popleft() != sequence:
            pass
        return True

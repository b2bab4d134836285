"""One direction of an emulated link, as a pure model: rate, drop-tail queue, delay.

Used by link_worker.py, which brings the packets and the time. It never looks at a clock and never sleeps, so that a
late caller makes packets late but never changes the rate.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What a direction does to packets; bytes are those of the IP packet."""

    rate_bit_s: float
    delay_s: float
    # What may wait for the link, the packet on the wire included; what finds it full is dropped.
    queue_bytes: int


class Direction:
    """The packets on the way in one direction; times are seconds of any clock that does not go back."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        # When the link has sent the packet at the head of `_waiting`.
        self._sent_at = 0.0
        self._flying: deque[tuple[float, bytes]] = deque()

    def offer(self, now: float, packet: bytes) -> None:
        self._send(now)
        if self._waiting_bytes + len(packet) > self._shape.queue_bytes:
            return
        if not self._waiting:
            self._sent_at = now + self._duration_s(packet)
        self._waiting.append(packet)
        self._waiting_bytes += len(packet)

    def due(self, now: float) -> Iterator[bytes]:
        self._send(now)
        while self._flying and self._flying[0][0] <= now:
            yield self._flying.popleft()[1]

    def next_at(self) -> float | None:
        times = [self._flying[0][0]] if self._flying else []
        return min([*times, self._sent_at] if self._waiting else times, default=None)

    def _send(self, now: float) -> None:
        """Move what the link has sent until `now` from the queue onto the way."""
        while self._waiting and self._sent_at <= now:
            packet = self._waiting.popleft()
            self._waiting_bytes -= len(packet)
            self._flying.append((self._sent_at + self._shape.delay_s, packet))
            if self._waiting:
                self._sent_at += self._duration_s(self._waiting[0])

    def _duration_s(self, packet: bytes) -> float:
        return len(packet) * 8 / self._shape.rate_bit_s

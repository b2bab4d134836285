"""One direction of an emulated link, as a pure model: rate, drop-tail queue, delay, jitter, loss.

Used by link_worker.py, which brings the packets and the time. It never looks at a clock and never sleeps, so that a
late caller makes packets late but never changes the rate.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from random import Random
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What a direction does to packets; bytes are those of the IP packet."""

    # None: as fast as the machine is.
    rate_bit_s: float | None = None
    delay_s: float = 0.0
    # Each packet is up to this much later or earlier, but never overtakes the one before it: as on a radio link, which
    # retransmits in order.
    jitter_s: float = 0.0
    # What may wait for the link, the packet on the wire included; what finds it full is dropped.
    queue_bytes: int = 256 * 1024
    loss: float = 0.0
    # Everything disappears, also what is on the way; addresses and routes stay as they are.
    blackhole: bool = False

    def __post_init__(self) -> None:
        if self.rate_bit_s is not None and self.rate_bit_s <= 0:
            raise ValueError(
                f"rate_bit_s is {self.rate_bit_s}; use blackhole for a link that passes nothing"
            )
        if not (0 <= self.loss <= 1 and self.jitter_s >= 0 and self.delay_s >= self.jitter_s):
            raise ValueError(
                f"loss is from 0 to 1, jitter from 0 to the delay, which this is not: {self}"
            )

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Shape:
        """Read what `as_dict` made."""
        return cls(**values)

    def as_dict(self) -> dict[str, Any]:
        """Return this as JSON can carry it."""
        return asdict(self)


@dataclass
class Counts:
    """What became of the packets of one direction."""

    passed: int = 0
    passed_bytes: int = 0
    lost: int = 0
    overflowed: int = 0
    swallowed: int = 0
    most_queued_bytes: int = 0


class Direction:
    """The packets on the way in one direction; times are seconds of any clock that does not go back."""

    def __init__(self, shape: Shape, rng: Random) -> None:
        self.counts = Counts()
        self._shape = shape
        self._rng = rng
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        # When the link has sent the packet at the head of `_waiting`.
        self._sent_at = 0.0
        self._flying: deque[tuple[float, bytes]] = deque()

    def offer(self, now: float, packet: bytes) -> None:
        """Take a packet that arrives at the link's entry."""
        self._send(now)
        if self._shape.blackhole:
            self.counts.swallowed += 1
        elif self._shape.loss and self._rng.random() < self._shape.loss:
            self.counts.lost += 1
        elif self._waiting_bytes + len(packet) > self._shape.queue_bytes:
            self.counts.overflowed += 1
        else:
            self._enqueue(now, packet)

    def due(self, now: float) -> Iterator[bytes]:
        """Yield what arrives at the other end until `now`."""
        self._send(now)
        while self._flying and self._flying[0][0] <= now:
            packet = self._flying.popleft()[1]
            if self._shape.blackhole:
                self.counts.swallowed += 1
                continue
            self.counts.passed += 1
            self.counts.passed_bytes += len(packet)
            yield packet

    def next_at(self) -> float | None:
        """Return when something happens next, if anything does."""
        times = [self._flying[0][0]] if self._flying else []
        return min([*times, self._sent_at] if self._waiting else times, default=None)

    def change(self, now: float, shape: Shape) -> None:
        """Be another link from now on; what flies arrives when it would have, what waits goes at the new rate."""
        self._send(now)
        if self._waiting:
            whole_s = self._duration_s(self._waiting[0])
            left = (self._sent_at - now) / whole_s if whole_s else 0.0
            self._shape = shape
            self._sent_at = now + left * self._duration_s(self._waiting[0])
        self._shape = shape

    def _enqueue(self, now: float, packet: bytes) -> None:
        if not self._waiting:
            self._sent_at = now + self._duration_s(packet)
        self._waiting.append(packet)
        self._waiting_bytes += len(packet)
        self.counts.most_queued_bytes = max(self.counts.most_queued_bytes, self._waiting_bytes)

    def _send(self, now: float) -> None:
        """Move what the link has sent until `now` from the queue onto the way."""
        while self._waiting and self._sent_at <= now:
            packet = self._waiting.popleft()
            self._waiting_bytes -= len(packet)
            self._fly(packet)
            if self._waiting:
                self._sent_at += self._duration_s(self._waiting[0])

    def _fly(self, packet: bytes) -> None:
        jitter_s = self._shape.jitter_s
        late_s = self._rng.uniform(-jitter_s, jitter_s) if jitter_s else 0.0
        arrives = self._sent_at + self._shape.delay_s + late_s
        if self._flying:
            arrives = max(arrives, self._flying[-1][0])
        self._flying.append((arrives, packet))

    def _duration_s(self, packet: bytes) -> float:
        rate = self._shape.rate_bit_s
        return 0.0 if rate is None else len(packet) * 8 / rate

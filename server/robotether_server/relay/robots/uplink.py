"""Measures what a robot sends: bytes of each camera, each topic, and the rest, as they arrive from its tunnels.

Whoever opens a connection to a robot counts it here, and `control_api` reads it. The kernel counts the bytes, also of a
message that is still on the way; nothing is done for a message, or while nobody reads. What SSH adds, heartbeats, and
shells, which do not pass the relay, are not seen.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from robotether_server.contract.uplink import UplinkKind, UplinkStream
from robotether_server.db.fleet import RECORDER

# Maximum and minimum time over which a rate is measured, and the interval between two samples of it.
MAX_SPAN_S = 5.0
MIN_SPAN_S = 1.0
SAMPLE_EVERY_S = 0.25
# Time for which the robot is not asked again what its line carries.
LINE_RATE_KEPT_S = 1.0

# Returns the bytes that came so far, None when that is not known.
ReceivedBytes = Callable[[], int | None]
UserIds = Callable[[], Collection[int]]


@dataclass(eq=False)
class _Source:
    """A connection; `read` is what it had brought by the last sample."""

    received: ReceivedBytes
    user_ids: UserIds
    read: int = 0


class RateCounter:
    """All connections of one stream, by the clock that is handed in."""

    def __init__(self, now_s: float) -> None:
        self.sources: list[_Source] = []
        self._ended = 0
        self._samples: deque[tuple[float, int]] = deque([(now_s, 0)])

    def add(self, received: ReceivedBytes, user_ids: UserIds) -> _Source:
        """Count a connection from now on."""
        source = _Source(received, user_ids)
        self.sources.append(source)
        return source

    def remove(self, source: _Source) -> None:
        """Count it no more; what it brought stays."""
        self._ended += source.received() or source.read
        self.sources.remove(source)

    def user_ids(self) -> set[int]:
        """Return who causes it, the recorder included."""
        return {user_id for source in self.sources for user_id in source.user_ids()}

    def bytes_per_s(self, now_s: float) -> int | None:
        """Sample it, and return the rate; None while it is not measured."""
        total = self._total()
        if total is None:
            return None
        samples = self._samples
        while samples and now_s - samples[0][0] > MAX_SPAN_S:
            samples.popleft()
        if not samples or now_s - samples[-1][0] >= SAMPLE_EVERY_S:
            samples.append((now_s, total))
        first_s, first = samples[0]
        if now_s - first_s < MIN_SPAN_S:
            return None
        return round((total - first) / (now_s - first_s))

    def _total(self) -> int | None:
        for source in self.sources:
            count = source.received()
            if count is None and not source.read:
                return None
            source.read = count or source.read
        return self._ended + sum(source.read for source in self.sources)


class Uplink:
    """What one robot sends, by kind and name."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._counters: dict[tuple[UplinkKind, str], RateCounter] = {}
        self._asking = asyncio.Lock()
        self._line_rate: int | None = None
        self._line_rate_until_s = 0.0

    @contextmanager
    def counted(
        self, kind: UplinkKind, name: str, received: ReceivedBytes, user_ids: UserIds
    ) -> Iterator[None]:
        """Count a connection inside the block."""
        counter = self._counters.setdefault((kind, name), RateCounter(self._clock()))
        source = counter.add(received, user_ids)
        try:
            yield
        finally:
            counter.remove(source)
            # Snapshots, which have no name, come one after the other.
            if name and not counter.sources:
                del self._counters[kind, name]

    async def measured(self, user_id: int) -> list[UplinkStream]:
        """Return all streams as this user gets them, the most first; takes MIN_SPAN_S when nobody has asked lately."""
        if any(stream.bytes_per_s is None for stream in self._streams(user_id)):
            await asyncio.sleep(MIN_SPAN_S)
        return sorted(self._streams(user_id), key=lambda stream: -(stream.bytes_per_s or 0))

    async def line_rate(self, ask: Callable[[], Awaitable[int | None]]) -> int | None:
        """Return what the robot answers to `ask`, in bytes a second; whoever wants it shares one question a second."""
        async with self._asking:
            if self._clock() >= self._line_rate_until_s:
                self._line_rate = await ask()
                self._line_rate_until_s = self._clock() + LINE_RATE_KEPT_S
            return self._line_rate

    def _streams(self, user_id: int) -> list[UplinkStream]:
        streams = []
        for (kind, name), counter in self._counters.items():
            rate, user_ids = counter.bytes_per_s(self._clock()), counter.user_ids()
            people = user_ids - {RECORDER.id}
            if rate or people:
                yours, recorded = user_id in people, people != user_ids
                streams.append(
                    UplinkStream(kind, name, rate, len(people), yours=yours, recorded=recorded)
                )
        return streams

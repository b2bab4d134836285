"""Shares the bytes that may be in flight on the media connection among its streams.

Used by the video proxy: each stream asks before it hands bytes to ssh. Never keeps the bytes themselves: a stream
without a turn does not read from the camera either. Without a connection to look at, or on a kernel that does
not report enough (before Linux 4.6), everybody gets what it wants at once, and the log says so once. The
connection is only looked at: it carries ssh, a process of its own.
"""

from __future__ import annotations

import asyncio
import fcntl
import logging
import socket
import struct
import termios
from collections import deque
from collections.abc import Callable

from robotether_agent.video.bandwidth_estimator import (
    MIN_BURST_SEGMENTS,
    BandwidthEstimator,
    Reading,
)

# Time after which unwritten data is stuck at a viewer that reads nothing, and must not delay the
# others.
STUCK_AFTER_S = 0.25
# Maximum sending time that idle senders save.
SAVED_S = 0.012
# Maximum interval between checks while a sender waits and until a frame has arrived: the end shows
# how fast it was. What is too little to show that is not followed.
CHECK_EVERY_S = 0.004
ARRIVES_WITHIN_S = 1.0
# Maximum and minimum size of one turn: a stream must not delay the others, and ssh must make no
# encrypted packets of a few bytes.
MAX_TURN_BYTES = 16 * 1024
MIN_TURN_BYTES = 2 * 1024
# Number of turns of which one is for bulk while others wait, too.
BULK_TURN = 4
# linux/tcp.h, struct tcp_info: 8 bytes of flags, 24 numbers of 32 bits, then what came with later kernels.
# Of them the segment's size, the round trip, the bytes that were acknowledged, and the shortest round trip, which is
# the newest; since Linux 4.6.
_INFO = struct.Struct("=16xI48xI48xQ20xI")
_INT = struct.Struct("=i")

log = logging.getLogger(__name__)

# How many bytes somebody wants to send, and what becomes of it.
Waiting = tuple[int, "asyncio.Future[int]"]


def read(connection: socket.socket, now_s: float) -> Reading | None:
    """Look at `connection`; nothing if the kernel does not report enough, or the connection is gone."""
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO.size)
        queued = _INT.unpack(fcntl.ioctl(connection, termios.TIOCOUTQ, bytes(_INT.size)))[0]
    except (OSError, ValueError):
        # ValueError: closed on our side.
        return None
    return None if len(info) < _INFO.size else _reading(info, queued, now_s)


def _reading(info: bytes, queued: int, now_s: float) -> Reading | None:
    segment, rtt_us, arrived, min_rtt_us = _INFO.unpack(info)
    if not rtt_us or min_rtt_us == 2**32 - 1:
        # Nothing has been measured yet.
        return None
    return Reading(
        at_s=now_s,
        written=arrived + queued,
        arrived=arrived,
        rtt_s=rtt_us / 1e6,
        min_rtt_s=min_rtt_us / 1e6,
        segment=segment,
    )


class UnwrittenBytes:
    """The bytes that were handed to ssh and that it has not written to its connection yet."""

    def __init__(self) -> None:
        self._bytes = 0
        self._since: Reading | None = None

    def add(self, count: int) -> None:
        """Note that `count` bytes go to ssh now."""
        self._bytes += count

    def remaining(self, reading: Reading) -> int:
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


class Pacer:
    """Decides which stream may send how much now, fairly in turns."""

    def __init__(self, read_state: Callable[[socket.socket, float], Reading | None] = read) -> None:
        self._read_state = read_state
        self._connection: socket.socket | None = None
        self._paced: tuple[BandwidthEstimator, TokenBucket] | None = None
        self._handed = UnwrittenBytes()
        # Bulk waits apart.
        self._waiting: deque[Waiting] = deque()
        self._bulk: deque[Waiting] = deque()
        self._turns = 0
        self._timer: asyncio.TimerHandle | None = None
        self._is_held = False
        self._warned = False
        # Somebody has waited since the last look.
        self._has_waited = False
        # A frame that was handed on may be under way until then.
        self._arrives_until_s = 0.0
        # At the last look, and what was handed on since.
        self._in_flight = 0

    def use(self, connection: socket.socket | None) -> None:
        """Look at this connection from now on; it stays the caller's."""
        self._connection = connection
        self._is_held = False
        self._paced = None
        self._handed = UnwrittenBytes()
        self._arrives_until_s = 0.0
        self._serve()

    def hold(self) -> None:
        """Let everybody wait for the next `use`: the connection ends."""
        self._connection = None
        self._is_held = True
        self._stop_timer()

    def line_rate(self) -> int | None:
        """Return the bytes a second that the line carries, None while nobody fills it or nothing is measured."""
        if self._paced is None:
            return None
        rate = self._paced[0].full_rate(asyncio.get_running_loop().time())
        return None if rate is None else round(rate)

    async def acquire(self, requested: int, *, is_bulk: bool = False) -> int:
        """Wait for a turn, and return how many of `requested` bytes to send in it: at least one.

        However many wait with bulk, all others together have three turns in four.
        """
        turn = asyncio.get_running_loop().create_future()
        (self._bulk if is_bulk else self._waiting).append((requested, turn))
        self._serve()
        granted: int = await turn
        return granted

    def _serve(self) -> None:
        self._stop_timer()
        self._drop_gone()
        if self._is_held or not (self._is_waited_for or self._arrives_until_s):
            return
        reading = self._read()
        if reading is None:
            self._grant_all()
            self._has_waited = False
            return
        self._grant(reading)
        self._has_waited = self._is_waited_for
        if self._has_waited or reading.at_s < self._arrives_until_s:
            self._timer = asyncio.get_running_loop().call_later(CHECK_EVERY_S, self._waited)

    def _waited(self) -> None:
        self._timer = None
        self._serve()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _read(self) -> Reading | None:
        if self._connection is None:
            self._warn_once("there is no connection to measure")
            return None
        reading = self._read_state(self._connection, asyncio.get_running_loop().time())
        if reading is None:
            self._warn_once(
                "the kernel reports too little about the connection (Linux before 4.6?)"
            )
        return reading

    def _warn_once(self, why: str) -> None:
        if not self._warned:
            self._warned = True
            log.warning("video is passed on unpaced: %s", why)

    def _room(self, reading: Reading) -> int:
        """Return how many bytes may go to ssh now."""
        if self._paced is None:
            estimator = BandwidthEstimator(reading)
            self._paced = estimator, TokenBucket(reading.at_s, estimator.window)
        estimator, bucket = self._paced
        left = self._handed.remaining(reading)
        self._in_flight = in_flight = reading.in_flight + left
        if not in_flight:
            self._arrives_until_s = 0.0
        is_handed = not (self._has_waited or left)
        estimator.update(reading, was_full=self._has_waited, is_handed=is_handed)
        saved = bucket.fill(
            reading.at_s, estimator.speed, has_waited=self._has_waited, least=MIN_TURN_BYTES
        )
        return min(saved, estimator.window - in_flight)

    def _grant(self, reading: Reading) -> None:
        """Give turns, first come first served; a stream that needs more than its turn queues again behind the others.

        What is left is shared among all who wait: whoever comes last in each round would get the smallest turns else.
        """
        room = self._room(reading)
        while self._is_waited_for:
            waiting = self._next()
            if room < min(waiting[0][0], MIN_TURN_BYTES):
                return
            share = max(MIN_TURN_BYTES, room // len(waiting))
            self._turns += 1
            requested, turn = waiting.popleft()
            granted = min(requested, room, share, MAX_TURN_BYTES)
            room -= granted
            self._note(granted, reading)
            turn.set_result(granted)
            if waiting is not self._bulk and self._bulk:
                # The stream of this turn may need the next one, before bulk gets the rest.
                asyncio.get_running_loop().call_soon(self._serve)
                return

    @property
    def _is_waited_for(self) -> bool:
        return bool(self._waiting or self._bulk)

    def _next(self) -> deque[Waiting]:
        """Return the queue whose turn it is."""
        if self._waiting and self._bulk:
            return self._waiting if self._turns % BULK_TURN else self._bulk
        return self._waiting or self._bulk

    def _note(self, granted: int, reading: Reading) -> None:
        self._handed.add(granted)
        self._in_flight += granted
        if self._in_flight >= MIN_BURST_SEGMENTS * reading.segment:
            self._arrives_until_s = reading.at_s + ARRIVES_WITHIN_S
        if self._paced is not None:
            self._paced[1].consume(granted)

    def _grant_all(self) -> None:
        while self._is_waited_for:
            requested, turn = self._next().popleft()
            turn.set_result(requested)

    def _drop_gone(self) -> None:
        """Forget those who were cancelled while they waited."""
        self._waiting, self._bulk = (
            deque((requested, turn) for requested, turn in waiting if not turn.done())
            for waiting in (self._waiting, self._bulk)
        )

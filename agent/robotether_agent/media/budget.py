"""Shares the bytes that may be under way on the media connection between all streams that want to send.

Used by the door: each stream takes before it hands bytes to ssh. Never keeps the bytes themselves: who does not get
its turn does not read from the camera either. Without a connection to look at, or on a kernel that does
not tell enough (before Linux 4.6), everybody gets what it wants at once, and the log says so once.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections import deque
from collections.abc import Callable

from robotether_agent.media.connection_state import Reading, read
from robotether_agent.media.meters import Bucket, Handed
from robotether_agent.media.pace import Pace

# Between two looks while somebody waits, and until what was handed on has arrived, but no longer than this: how fast
# a picture went is seen at its end.
LOOK_EVERY_S = 0.004
ARRIVES_WITHIN_S = 1.0
# The most in one turn, so that a stream does not wait long for the others, and the least, so that ssh makes no
# encrypted packets of a few bytes.
TURN_MAX = 16 * 1024
TURN_MIN = 2 * 1024

log = logging.getLogger(__name__)


class Budget:
    """Who may send how much now, fairly in turns."""

    def __init__(self, look: Callable[[socket.socket, float], Reading | None] = read) -> None:
        self._look = look
        self._connection: socket.socket | None = None
        self._paced: tuple[Pace, Bucket] | None = None
        self._handed = Handed()
        self._waiting: deque[tuple[int, asyncio.Future[int]]] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._is_held = False
        self._told = False
        # Somebody has waited since the last look.
        self._is_wanted = False
        # What was handed on until then may still be under way.
        self._arrives_until_s = 0.0

    def use(self, connection: socket.socket | None) -> None:
        """Look at this connection from now on; it stays the caller's."""
        self._connection = connection
        self._is_held = False
        self._paced = None
        self._handed = Handed()
        self._arrives_until_s = 0.0
        self._serve()

    def hold(self) -> None:
        """Let everybody wait for the next `use`: the connection ends."""
        self._connection = None
        self._is_held = True
        self._stop_timer()

    async def take(self, wanted: int) -> int:
        """Wait for a turn, and return how many of `wanted` bytes to send in it: at least one."""
        turn = asyncio.get_running_loop().create_future()
        self._waiting.append((wanted, turn))
        self._serve()
        granted: int = await turn
        return granted

    def _serve(self) -> None:
        self._stop_timer()
        self._drop_gone()
        if self._is_held or not (self._waiting or self._arrives_until_s):
            return
        reading = self._read()
        if reading is None:
            self._grant_all()
            self._is_wanted = False
            return
        self._grant(reading)
        self._is_wanted = bool(self._waiting)
        if self._is_wanted or reading.at_s < self._arrives_until_s:
            self._timer = asyncio.get_running_loop().call_later(LOOK_EVERY_S, self._waited)

    def _waited(self) -> None:
        self._timer = None
        self._serve()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _read(self) -> Reading | None:
        if self._connection is None:
            self._tell_once("there is no connection to look at")
            return None
        reading = self._look(self._connection, asyncio.get_running_loop().time())
        if reading is None:
            self._tell_once("the kernel tells too little of the connection (Linux before 4.6?)")
        return reading

    def _tell_once(self, why: str) -> None:
        if not self._told:
            self._told = True
            log.warning("video is passed on as fast as it comes: %s", why)

    def _room(self, reading: Reading) -> int:
        """Return how many bytes may go to ssh now."""
        if self._paced is None:
            pace = Pace(reading)
            self._paced = pace, Bucket(reading.at_s, pace.window)
        pace, bucket = self._paced
        left = self._handed.left(reading)
        under_way = reading.under_way + left
        if not under_way:
            self._arrives_until_s = 0.0
        is_handed = not (self._is_wanted or left)
        pace.update(reading, was_full=self._is_wanted, is_handed=is_handed)
        saved = bucket.fill(reading.at_s, pace.speed, was_wanted=self._is_wanted, least=TURN_MIN)
        return min(saved, pace.window - under_way)

    def _grant(self, reading: Reading) -> None:
        """Give turns, first come first served; who wants more than its turn queues again behind the others.

        What is left is shared among all who wait: whoever comes last in each round would get the smallest turns else.
        """
        room = self._room(reading)
        while self._waiting and room >= min(self._waiting[0][0], TURN_MIN):
            share = max(TURN_MIN, room // len(self._waiting))
            wanted, turn = self._waiting.popleft()
            granted = min(wanted, room, share, TURN_MAX)
            room -= granted
            self._note(granted, reading.at_s)
            turn.set_result(granted)

    def _note(self, granted: int, now_s: float) -> None:
        self._handed.add(granted)
        self._arrives_until_s = now_s + ARRIVES_WITHIN_S
        if self._paced is not None:
            self._paced[1].take(granted)

    def _grant_all(self) -> None:
        while self._waiting:
            wanted, turn = self._waiting.popleft()
            turn.set_result(wanted)

    def _drop_gone(self) -> None:
        """Forget those who were cancelled while they waited."""
        self._waiting = deque((wanted, turn) for wanted, turn in self._waiting if not turn.done())

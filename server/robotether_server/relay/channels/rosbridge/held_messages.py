"""What a client publishes, until rosbridge has the topics that it has just subscribed to.

A subscription takes another way to the robot than what is published, and the client expects its message back, or the
result of its goal. All that the client sends later follows it: no goal may come behind the call that cancels it. A
drive command never waits.
"""

from __future__ import annotations

import asyncio
from collections import deque

from robotether_server.relay.robots.demand import OPENS_WITHIN_S

# Maximum size of what waits of one client, and then again of what the robot has not taken yet.
MAX_HELD_BYTES = 1024 * 1024
# Time limit for waiting.
HELD_FOR_S = OPENS_WITHIN_S


class HeldMessages:
    """What one client published that waits; `subscriptions` says for which topics."""

    def __init__(self) -> None:
        # With the topics that each waits for.
        self._held: deque[tuple[frozenset[str], bytes]] = deque()
        self._held_bytes = 0
        # Of the topics that rosbridge does not have yet.
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._released: asyncio.Queue[bytes] = asyncio.Queue()
        self._released_bytes = 0

    @property
    def is_full(self) -> bool:
        """Whether the robot has too much to take before more is added."""
        return self._released_bytes > MAX_HELD_BYTES

    async def room(self) -> None:
        """Wait until there is room for another message."""
        if self.is_full:
            await self._released.join()

    def begin(self, topic: str) -> None:
        """Hold what is published from now on until `release` of this topic, for HELD_FOR_S at most."""
        if topic not in self._timers:
            loop = asyncio.get_running_loop()
            self._timers[topic] = loop.call_later(HELD_FOR_S, self.release, topic)

    def add(self, message: bytes, *, is_published: bool) -> bool:
        """Keep a message until `next` returns it; False: it need not wait."""
        topics = frozenset(self._timers if is_published else ())
        if not topics and not self._held and self._released.empty():
            return False
        self._held.append((topics, message))
        self._held_bytes += len(message)
        self._let_go()
        return True

    def release(self, topic: str) -> None:
        """Let go what waits for a subscription, and hold no more."""
        if topic in self._timers:
            self._timers.pop(topic).cancel()
            self._let_go()

    async def next(self) -> bytes:
        """Return what goes to the robot now."""
        message = await self._released.get()
        self._released.task_done()
        self._released_bytes -= len(message)
        return message

    def _let_go(self) -> None:
        while self._held and (
            self._held[0][0].isdisjoint(self._timers) or self._held_bytes > MAX_HELD_BYTES
        ):
            _, message = self._held.popleft()
            self._held_bytes -= len(message)
            self._released_bytes += len(message)
            self._released.put_nowait(message)

"""What a client publishes to a topic that it has just subscribed to, until rosbridge has the subscription.

A subscription takes another way to the robot than what is published, and the client expects its message back. A drive
command never waits here.
"""

from __future__ import annotations

import asyncio

# Maximum size of what waits for one subscription.
MAX_HELD_BYTES = 1024 * 1024


class HeldMessages:
    """What one client published that waits; `subscriptions` says for which topics."""

    def __init__(self) -> None:
        self._held: dict[str, list[bytes]] = {}
        self._released: asyncio.Queue[bytes] = asyncio.Queue()

    def begin(self, topic: str) -> None:
        """Hold what is published to a topic from now on."""
        self._held.setdefault(topic, [])

    def add(self, topic: str, message: bytes) -> bool:
        """Keep a message until `next` returns it; False: it need not wait."""
        held = self._held.get(topic)
        if held is not None:
            held.append(message)
            if sum(map(len, held)) > MAX_HELD_BYTES:
                self.release(topic)
        elif not self._released.empty():
            self._released.put_nowait(message)
        else:
            return False
        return True

    def release(self, topic: str) -> None:
        """Let go what waits for a subscription, and hold no more."""
        for message in self._held.pop(topic, ()):
            self._released.put_nowait(message)

    async def next(self) -> bytes:
        """Return what goes to the robot now."""
        return await self._released.get()

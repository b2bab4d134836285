"""What waits to be sent to one client, bounded.

The real rosbridge's queue has no bound, so a client that does not read makes it grow until the robot has
no memory left. Here the oldest topic messages make room for new ones; replies are never dropped, and a
client that lets too many of them pile up is cut off by server.py.
"""

import asyncio
from collections import deque
from typing import NamedTuple

MESSAGES_LIMIT = 1000
BYTES_LIMIT = 16 * 1024 * 1024


class _Entry(NamedTuple):
    data: str | bytes
    droppable: bool


class Outbox:
    """A queue with one reader."""

    def __init__(
        self, messages_limit: int = MESSAGES_LIMIT, bytes_limit: int = BYTES_LIMIT
    ) -> None:
        self._messages_limit = messages_limit
        self._bytes_limit = bytes_limit
        self._entries: deque[_Entry] = deque()
        self._size = 0
        self._filled = asyncio.Event()
        self.dropped = 0
        self.overflowed = False

    def __len__(self) -> int:
        """Count what waits."""
        return len(self._entries)

    def put_message(self, data: str | bytes) -> None:
        """Queue a topic message; the oldest ones go when there is no room."""
        self._put(_Entry(data, droppable=True))

    def put_reply(self, data: str | bytes) -> None:
        """Queue a reply; `overflowed` tells when even dropping made no room."""
        self._put(_Entry(data, droppable=False))

    async def get(self) -> str | bytes:
        """Wait for the next one."""
        while not self._entries:
            self._filled.clear()
            await self._filled.wait()
        entry = self._entries.popleft()
        self._size -= len(entry.data)
        return entry.data

    def _put(self, entry: _Entry) -> None:
        if self.overflowed:
            return
        self._entries.append(entry)
        self._size += len(entry.data)
        while self._is_full() and self._drop_oldest():
            self.dropped += 1
        self.overflowed = self._is_full()
        self._filled.set()

    def _is_full(self) -> bool:
        # One alone may be larger than the limit: it has to go out somehow.
        too_large = self._size > self._bytes_limit and len(self._entries) > 1
        return too_large or len(self._entries) > self._messages_limit

    def _drop_oldest(self) -> bool:
        for index, entry in enumerate(self._entries):
            if entry.droppable:
                del self._entries[index]
                self._size -= len(entry.data)
                return True
        return False

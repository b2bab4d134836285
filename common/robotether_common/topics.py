"""The topics service (docs/reference/media.md, "Topics") as agent and relay know it: its path, its bounds, its queue.

Each connection carries one subscription, so that none of its messages is parsed to learn whose it is.
"""

from __future__ import annotations

import re
import zlib
from collections import deque
from typing import Generic, TypeVar

Kind = TypeVar("Kind")

PATH = "/robotether/topics"
# Maximum size of a subscription, the only message that the relay sends.
MAX_SUBSCRIPTION_BYTES = 16 * 1024
# Maximum number of topics that one robot sends at once.
MAX_TOPICS = 64
# The query's member with the digests of messages that the relay still has, and the operation that names one of them.
KNOWN = "known"
KNOWN_OP = "robotether.known"
MAX_KNOWN = 32
# The time at which rosbridge got a message, in what it writes as `cbor-raw`, and in which head that is. It is another
# one each time that rosbridge repeats the message.
RECEIVED, MAX_HEAD_BYTES = re.compile(rb"cmsg\xa3dsecs.{1,9}?ensecs.{1,9}?ebytes", re.DOTALL), 400

# Maximum size of waiting messages, of those that may grow old, and time after which these are old.
MAX_WAITING_BYTES = 256 * 1024
FRESH_BYTES = 16 * 1024
OLD_AFTER_S = 0.5


def digest(message: bytes) -> str:
    """Return what tells a message from the few others of its topic; no proof against a forger."""
    received = RECEIVED.search(message, 0, MAX_HEAD_BYTES)
    content = message if received is None else message[received.end() :]
    return f"{zlib.crc32(content):08x}{len(content):x}"


class MessageQueue(Generic[Kind]):
    """Messages of one topic for one receiver; a slow one gets the newest, and the newest is never dropped.

    `queue_length` messages are kept however old they are, as a subscription may request; 0: those that are not old.
    """

    def __init__(self, queue_length: int) -> None:
        self._max_count = queue_length
        self._messages: deque[tuple[float, bytes, Kind]] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._messages)

    def push(self, message: bytes, kind: Kind, now_s: float) -> None:
        """Add the newest message; what it makes too many goes."""
        self._messages.append((now_s, message, kind))
        self._bytes += len(message)
        while len(self._messages) > 1 and self._is_too_much(now_s):
            self.pop()

    def pop(self) -> tuple[bytes, Kind]:
        """Take the oldest message; there must be one."""
        _, message, kind = self._messages.popleft()
        self._bytes -= len(message)
        return message, kind

    def _is_too_much(self, now_s: float) -> bool:
        if self._bytes > MAX_WAITING_BYTES or 0 < self._max_count < len(self._messages):
            return True
        is_old = now_s - self._messages[0][0] > OLD_AFTER_S
        return is_old and self._bytes > FRESH_BYTES and self._max_count == 0

"""Remembers whose logins and tokens the database confirmed lately, so that web signs tickets while it is away.

Each process of web has its own, and need not know what ended meanwhile: such a ticket says that it is from memory,
and the relay decides by the robots and rights that it read last, and by the logins and tokens that it knows to hold.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from robotether_server.tickets import CredentialKind

RECENT_S = 15 * 60.0
MAX_RECENT = 10_000

# Its kind and its SHA-256, in hex.
CredentialKey = tuple[CredentialKind, str]


@dataclass(frozen=True)
class RecentUser:
    """Who a login or token belongs to."""

    id: int
    name: str


class RecentUsers:
    """The users of logins and tokens; safe to share between threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        # The oldest first.
        self._users: dict[CredentialKey, tuple[float, RecentUser]] = {}

    def note(self, credential: CredentialKey, user: RecentUser) -> None:
        """Remember what the database has just confirmed."""
        with self._lock:
            self._users.pop(credential, None)
            self._users[credential] = self._clock(), user
            if len(self._users) > MAX_RECENT:
                del self._users[next(iter(self._users))]

    def find(self, credential: CredentialKey) -> RecentUser | None:
        """Return whose it was, if that was confirmed not long ago."""
        with self._lock:
            at, user = self._users.get(credential, (0.0, None))
        return user if self._clock() - at < RECENT_S else None

    def forget(self, credential: CredentialKey) -> None:
        """Forget a login or token that the database has just denied."""
        with self._lock:
            self._users.pop(credential, None)

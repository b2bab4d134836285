"""Remembers which rights the database confirmed lately, so that web signs tickets while the database is away.

Each process of web has its own, and need not know what ended meanwhile: such a ticket says that it is from memory,
and the relay decides by the rights that it read last, and by the logins and tokens that it knows to hold.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from robotether_server.schemas import Level
from robotether_server.tickets import CredentialKind

RECENT_S = 15 * 60.0
MAX_RECENT = 10_000

# Its kind and its SHA-256, in hex.
CredentialKey = tuple[CredentialKind, str]


@dataclass(frozen=True)
class RecentRight:
    """What a user may do with a robot."""

    user_id: int
    user: str
    robot_id: int
    level: Level


class RecentRights:
    """The rights of logins and tokens on robots, by their names; safe to share between threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        # The oldest first.
        self._rights: dict[tuple[CredentialKey, str], tuple[float, RecentRight]] = {}

    def note(self, credential: CredentialKey, robot: str, right: RecentRight) -> None:
        """Remember what the database has just confirmed."""
        with self._lock:
            self._rights.pop((credential, robot), None)
            self._rights[credential, robot] = self._clock(), right
            if len(self._rights) > MAX_RECENT:
                del self._rights[next(iter(self._rights))]

    def find(self, credential: CredentialKey, robot: str) -> RecentRight | None:
        """Return a right that was confirmed not long ago."""
        with self._lock:
            at, right = self._rights.get((credential, robot), (0.0, None))
        return right if self._clock() - at < RECENT_S else None

    def forget(self, credential: CredentialKey, robot: str | None = None) -> None:
        """Forget a right that the database has just denied; without a robot, all of this login or token."""
        with self._lock:
            for key in [key for key in self._rights if key[0] == credential]:
                if robot in {None, key[1]}:
                    del self._rights[key]

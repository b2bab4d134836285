"""Which robot has got its message, how long that took, and what came that was not meant for it.

Made for one run, a start or a return of the whole fleet; operators ask for texts, workers tell what robots heard. Times
are this machine's monotonic clock, which its processes share.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from typing import Any

NS_PER_S = 1e9
# More different wrong texts than this tell nothing new.
MAX_WRONG_TEXTS = 20


class Arrivals:
    """One message for each robot, that names the robot and the run."""

    def __init__(self, robots: Sequence[str], run: str, began_ns: int) -> None:
        self._run = run
        self._began_ns = began_ns
        self._arrived = {robot: asyncio.Event() for robot in robots}
        self._message_s: dict[str, float] = {}
        self._online_s: dict[str, float] = {}
        self._server_s: float | None = None
        self._published: Counter[str] = Counter()
        self._received: Counter[str] = Counter()
        self._wrong: list[str] = []
        # Why operators had to try again, in the server's own words.
        self._waits: Counter[str] = Counter()

    def text(self, robot: str) -> str:
        """What an operator sends now; no two texts are the same."""
        self._published[robot] += 1
        return f"{robot} {self._run} {self._published[robot]}"

    def is_online(self, robot: str, at_ns: int) -> None:
        """Note that the server says so; the first time counts."""
        if robot in self._arrived:
            self._online_s.setdefault(robot, self._seconds(at_ns))

    def server_answers(self, at_ns: int) -> None:
        """Note that the server, of which some was restarted, tells of its fleet again; the first time counts."""
        if self._server_s is None:
            self._server_s = self._seconds(at_ns)

    def waits(self, why: str) -> None:
        """Note that a robot could not be reached yet."""
        self._waits[why] += 1

    def got(self, robot: str, text: str, at_ns: int) -> None:
        """Note what a robot heard."""
        name, _, rest = text.partition(" ")
        run, _, number = rest.rpartition(" ")
        sent = number.isdecimal() and 1 <= int(number) <= self._published[robot]
        if robot not in self._arrived or (name, run) != (robot, self._run) or not sent:
            self._wrong.append(f"{robot} got {text!r:.100}")
            return
        self._received[robot] += 1
        self._message_s.setdefault(robot, self._seconds(at_ns))
        self._arrived[robot].set()

    def has_arrived(self, robot: str) -> bool:
        """Whether a robot has got its message."""
        return self._arrived[robot].is_set()

    async def until_arrived(self, robot: str) -> None:
        """Wait for it."""
        await self._arrived[robot].wait()

    def values(self) -> dict[str, Any]:
        """For the results: lists have one place a robot, null where it did not happen; seconds."""
        return {
            "message_s": [_rounded(self._message_s.get(robot)) for robot in self._arrived],
            "online_s": [_rounded(self._online_s.get(robot)) for robot in self._arrived],
            "server_s": _rounded(self._server_s),
            "published": self._published.total(),
            "received": self._received.total(),
            "wrong": len(self._wrong),
            "wrong_texts": self._wrong[:MAX_WRONG_TEXTS],
            "waits": dict(self._waits.most_common()),
        }

    def _seconds(self, at_ns: int) -> float:
        return (at_ns - self._began_ns) / NS_PER_S


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 4)

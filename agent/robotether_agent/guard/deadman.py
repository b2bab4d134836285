"""Decides when each drive topic gets the guard's zeros: after the deadman time, or at once.

Kept by the drive controller, which alone sends. Per topic: idle (nothing to do), moving (a command that moves was sent
last) or zeroing (ten zeros at 20 Hz, counted when they were sent, then idle). A topic that never moved gets none,
unless `force` says so. Knows no clock: every time in seconds is given. Pure.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Literal

ZERO_EVERY_S = 0.05
ZEROS = 10

State = Literal["idle", "moving", "zeroing"]


@dataclass
class _Topic:
    state: State = "idle"
    # moving: when the zeros begin; zeroing: when the next one goes out.
    due: float = 0.0
    # Zeros that are not sent yet.
    left: int = ZEROS


class Deadman:
    """The phases of all drive topics that somebody has driven."""

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self._topics: dict[str, _Topic] = {}

    @property
    def state(self) -> State:
        """The most urgent one of all topics."""
        states = {topic.state for topic in self._topics.values()}
        return "moving" if "moving" in states else "zeroing" if "zeroing" in states else "idle"

    @property
    def owes(self) -> bool:
        """Whether a zero is due that could not be sent yet; it goes before any command."""
        return any(t.state == "zeroing" and t.left == ZEROS for t in self._topics.values())

    def is_moving(self, name: str) -> bool:
        """Tell whether the robot was told on this topic last to move."""
        return self._is(name, "moving")

    def is_at_rest(self, name: str) -> bool:
        """Tell whether the robot was told on this topic last to stand, and has got its zeros."""
        return name not in self._topics or self._is(name, "idle")

    def moving(self) -> list[str]:
        """Name the topics on which the robot was told to move last."""
        return [name for name, topic in self._topics.items() if topic.state == "moving"]

    def commanded(self, name: str, now: float, *, moves: bool) -> None:
        """Note that a command was sent; one that does not move ends the motion."""
        topic = self._topics.setdefault(name, _Topic())
        topic.state, topic.due = ("moving", now + self.timeout_s) if moves else ("idle", 0.0)

    def stop(self, names: Iterable[str], now: float) -> None:
        """Begin the zeros on those of `names` that move."""
        self.force([name for name in names if self._is(name, "moving")], now)

    def force(self, names: Iterable[str], now: float) -> None:
        """Begin the zeros on `names`, whatever they do."""
        for name in names:
            self._topics[name] = _Topic("zeroing", now)

    def due(self, now: float) -> list[str]:
        """Name the topics that get a zero now. `zeroed` or `postponed` must follow for each."""
        self.stop([name for name in self.moving() if self._topics[name].due <= now], now)
        return [n for n, t in self._topics.items() if t.state == "zeroing" and t.due <= now]

    def forget(self, known: Container[str]) -> None:
        """Forget the topics that stand and are not `known` any more."""
        gone = [n for n in self._topics if n not in known and self.is_at_rest(n)]
        for name in gone:
            del self._topics[name]

    def zeroed(self, name: str, now: float) -> None:
        """Note that a zero was sent."""
        topic = self._topics.get(name)
        if topic is None or topic.state != "zeroing":
            return
        topic.due, topic.left = now + ZERO_EVERY_S, topic.left - 1
        if topic.left == 0:
            topic.state = "idle"

    def postponed(self, name: str, now: float) -> None:
        """Note that a zero could not be sent; it is due again soon."""
        if name in self._topics:
            self._topics[name].due = now + ZERO_EVERY_S

    def hurry(self, now: float) -> None:
        """Make due what is owed: it can be sent again."""
        for topic in self._topics.values():
            if topic.state == "zeroing" and topic.left == ZEROS:
                topic.due = min(topic.due, now)

    def restart_zeros(self) -> None:
        """Forget the zeros of a connection that is lost: nobody knows which of them arrived."""
        for topic in self._topics.values():
            topic.left = ZEROS

    def next_at(self) -> float | None:
        """Return when `due` must be asked next, or None: only after another event."""
        times = [topic.due for topic in self._topics.values() if topic.state != "idle"]
        return min(times, default=None)

    def _is(self, name: str, state: State) -> bool:
        return name in self._topics and self._topics[name].state == state

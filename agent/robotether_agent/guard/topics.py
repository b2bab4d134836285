"""The state of each drive topic: last command, its sender, and what waits for rosbridge. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from robotether_common.guard import RefusedKind

from robotether_agent.guard.authorization import Authorization
from robotether_agent.guard.commands import SHAPES, CheckedCommand, Shape
from robotether_agent.guard.drive_messages import MessageId
from robotether_agent.guard.refused import Refused

MAX_TOPICS = 16
# A client advertises a topic once, so the type outlives the place. Without one, rosbridge takes what its graph says of
# the topic: just after its start that is nothing, and it refuses the zeros. Nor does an empty message, which is a zero,
# show what it is.
MAX_TYPES = 64


class CommandSource(Protocol):
    """Who sends drive messages: a client proxy."""

    @property
    def authorization(self) -> Authorization:
        """What it may do."""

    def refuse(self, kind: RefusedKind, text: str, message_id: MessageId) -> None:
        """Answer a message that goes no further."""

    def notify(self, data: bytes) -> None:
        """Pass on what rosbridge says to its commands."""


@dataclass(frozen=True)
class PendingCommand:
    """A checked command on its way, which may be sent until `old_at`."""

    command: CheckedCommand
    source: CommandSource
    old_at: float
    message_id: MessageId


@dataclass
class Topic:
    """A drive topic that somebody advertised or drove; `type` as it was advertised, or empty."""

    name: str
    type: str = ""
    announced: bool = False
    sent: CheckedCommand | None = None
    sent_at: float = 0.0
    source: CommandSource | None = None
    waiting: PendingCommand | None = None
    # Whether it ever got a command that moves.
    moved: bool = False
    used_at: float = 0.0

    @property
    def declared(self) -> Shape | None:
        """The shape of the advertised type."""
        return SHAPES.get(self.type)


class Topics:
    """All of them; their number is bounded, since operators name them. Those in `named` have places of their own."""

    def __init__(self) -> None:
        self.named: frozenset[str] = frozenset()
        self._topics: dict[str, Topic] = {}
        self._types: dict[str, str] = {}
        self._parting: dict[str, None] = {}

    def __iter__(self) -> Iterator[Topic]:
        """Give all in the order in which they were named first."""
        return iter(tuple(self._topics.values()))

    def __contains__(self, name: object) -> bool:
        """Tell whether there is a topic of this name."""
        return name in self._topics

    def find(self, name: str) -> Topic | None:
        """Return the topic of this name, None if there is none."""
        return self._topics.get(name)

    def add(self, name: str) -> Topic:
        """Return the topic of this name, however many there are."""
        # It was to be unadvertised, which must not come after its next command.
        self._parting.pop(name, None)
        if name not in self._topics:
            self._topics[name] = Topic(name, self._types.pop(name, ""))
        return self._topics[name]

    def ensure(self, name: str, now: float, is_removable: Callable[[Topic], bool]) -> Topic:
        """Return the topic of this name; one that `is_removable` makes room for it, or it is Refused."""
        if name not in self._topics and name not in self.named:
            self._make_room(is_removable)
        topic = self.add(name)
        topic.used_at = now
        return topic

    def free_unmoved(self, is_removable: Callable[[Topic], bool]) -> None:
        """Free the places of topics that never moved anything, and forget the types of those that made room."""
        for topic in self._guests():
            if not topic.moved and is_removable(topic):
                self._forget(topic)
        self._types.clear()

    @property
    def parting(self) -> bool:
        """Whether rosbridge knows topics that were forgotten."""
        return bool(self._parting)

    def next_parting(self) -> str:
        """Return, once, the name of such a topic."""
        return self._parting.popitem()[0]

    def on_rosbridge_lost(self) -> None:
        """Note that the next rosbridge knows none of them."""
        self._parting.clear()
        for topic in self:
            topic.announced = False

    def _guests(self) -> list[Topic]:
        return [topic for topic in self if topic.name not in self.named]

    def _make_room(self, is_removable: Callable[[Topic], bool]) -> None:
        guests = self._guests()
        if len(guests) < MAX_TOPICS:
            return
        goes = min(
            filter(is_removable, guests), key=lambda t: max(t.used_at, t.sent_at), default=None
        )
        if goes is None:
            raise Refused(
                "shape",
                f"the guard already has {MAX_TOPICS} drive topics, and can drop none now",
            )
        self._forget(goes)

    def _forget(self, topic: Topic) -> None:
        del self._topics[topic.name]
        if topic.announced or topic.sent is not None:
            self._parting[topic.name] = None
        if topic.type:
            self._types[topic.name] = topic.type
            if len(self._types) > MAX_TYPES:
                del self._types[next(iter(self._types))]
        # Whoever still has it in hand must not advertise it again.
        topic.type = ""

    def of(self, concerned: Callable[[CommandSource], bool]) -> list[str]:
        """Name the topics that such a source moved last."""
        return [t.name for t in self if t.source is not None and concerned(t.source)]

    def forget_waiting(self, concerned: Callable[[CommandSource], bool]) -> None:
        """Drop what such a source sent and rosbridge has not got."""
        for topic in self:
            if topic.waiting is not None and concerned(topic.waiting.source):
                topic.waiting = None

    def forget_source(self, source: CommandSource) -> None:
        """Let go of a source that is gone."""
        for topic in self:
            if topic.source is source:
                topic.source = None

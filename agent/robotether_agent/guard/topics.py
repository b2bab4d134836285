"""What the drive controller knows of each drive topic: the last command, when zeros are due, and that the robot moves.

`Topics` keeps the last command, its sender, and what waits for rosbridge. `Deadman` decides when a topic gets the
guard's zeros: after the deadman time, or at once. Both are pure and know no clock: every time in seconds is given.

`MotionFile` writes a file (motion.json) before the robot moves, so that the next guard can stop it. It is in the
run directory and outlives a crash: what it says of a topic must be what the next guard needs to zero it.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, Protocol

from robotether_common.guard import RefusedKind
from robotether_common.ros import NAME, full_name

from robotether_agent.fields import (
    FieldError,
    JsonObject,
    as_object,
    get_match,
    get_text,
    parse_object,
)
from robotether_agent.files import disk_problem, read_text, remove
from robotether_agent.guard.drive_messages import (
    MAX_FRAME_ID_LENGTH,
    SHAPES,
    CheckedCommand,
    DriveMessageRefusedError,
    MessageId,
    Shape,
)
from robotether_agent.guard.seen_age import DriverView, SeenFrames
from robotether_agent.problems import StateUnusableError

MAX_TOPICS = 16
# Maximum number of topics whose type is stored. A client advertises a topic once, so the type
# outlives the topic. Without it rosbridge uses its graph, which is empty just after its start, and
# rejects the zeros; nor does an empty message, which is a zero, show its type.
MAX_TYPES = 64
ZERO_EVERY_S = 0.05
ZEROS = 10
# Number of zeros at a new rosbridge, or of a new guard: its publisher and the base need seconds to
# find each other on a slow robot.
ZEROS_AFTER_RECONNECT = 60
MOTION_FILE = "motion.json"
# Delay before the motion file is removed: the next motion often follows soon, and need not write it
# again.
REMOVED_AFTER_S = 1.0

Mode = Literal["observe", "drive", "direct"]
State = Literal["idle", "moving", "zeroing"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Authorization:
    """What a connection was let in for; `fence` is 0 unless it drives with a lease."""

    mode: Mode
    fence: int = 0


class CommandSource(Protocol):
    """A sender of drive messages: a client proxy."""

    view: DriverView

    @property
    def authorization(self) -> Authorization:
        """What it may do."""

    def refuse(self, kind: RefusedKind, text: str, message_id: MessageId) -> None:
        """Answer a message that goes no further."""

    def notify(self, data: bytes) -> None:
        """Pass on what rosbridge says to its commands."""


@dataclass(frozen=True)
class PendingCommand:
    """A checked command under way, which may be sent until `old_at`."""

    command: CheckedCommand
    source: CommandSource
    old_at: float
    message_id: MessageId
    # None: its client names no frames.
    seen: SeenFrames | None = None


@dataclass
class Topic:
    """A drive topic that somebody advertised or drove; `type` as it was advertised, or empty."""

    name: str
    type: str = ""
    announced: bool = False
    sent: CheckedCommand | None = None
    sent_at: float = 0.0
    source: CommandSource | None = None
    # What the driver saw at the last command if that moves and its age counts, whether it was slowed
    # for it, and when to look again.
    seen: SeenFrames | None = None
    is_slowed: bool = False
    slow_at: float = 0.0
    waiting: PendingCommand | None = None
    # Whether it ever got a command that moves.
    moved: bool = False
    used_at: float = 0.0
    announced_at: float = 0.0
    # Until when it is not advertised, so that rosbridge forgets it.
    withheld_until: float = 0.0

    @property
    def declared(self) -> Shape | None:
        """The shape of the advertised type."""
        return SHAPES.get(self.type)


class Topics:
    """All of them; their number is bounded, since operators name them. Those in `named` do not count."""

    def __init__(self) -> None:
        self.named: frozenset[str] = frozenset()
        self._topics: dict[str, Topic] = {}
        self._types: dict[str, str] = {}
        self._parting: dict[str, None] = {}

    def __iter__(self) -> Iterator[Topic]:
        """Give all in the order in which they were named first."""
        return iter(tuple(self._topics.values()))

    def __contains__(self, name: object) -> bool:
        """Return whether there is a topic of this name."""
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
        """Return the topic of this name; one that `is_removable` makes room for it, else it is refused."""
        if name not in self._topics and name not in self.named:
            self._make_room(is_removable)
        topic = self.add(name)
        topic.used_at = now
        return topic

    def free_unmoved(self, is_removable: Callable[[Topic], bool]) -> None:
        """Free topics that never moved anything, and forget the types of those that made room."""
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
            raise DriveMessageRefusedError(
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

    def withhold(self, topic: Topic, until: float) -> None:
        """Have rosbridge forget a topic, and advertise it again then."""
        topic.announced, topic.withheld_until = False, until
        self._parting[topic.name] = None

    def of(self, concerned: Callable[[CommandSource], bool]) -> list[str]:
        """Name the topics that such a source moved last."""
        return [t.name for t in self if t.source is not None and concerned(t.source)]

    def forget_waiting(self, concerned: Callable[[CommandSource], bool]) -> None:
        """Drop what such a source sent and rosbridge has not got."""
        for topic in self:
            if topic.waiting is not None and concerned(topic.waiting.source):
                topic.waiting = None


@dataclass
class _Phase:
    state: State = "idle"
    # moving: when the zeros begin; zeroing: when the next one goes out.
    due: float = 0.0
    # Zeros that are not sent yet, and whether one of them was.
    left: int = ZEROS
    has_begun: bool = False


class Deadman:
    """The phases of all drive topics that somebody has driven.

    A topic is idle (nothing to do), moving (a command that moves was sent last) or zeroing (ten zeros at 20 Hz, counted
    when they were sent, then idle; 60 on a new connection to rosbridge). One that never moved gets none, unless `force`
    says so.
    """

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        # Number of times that a next command stayed away.
        self.silences = 0
        self._topics: dict[str, _Phase] = {}

    @property
    def state(self) -> State:
        """The most urgent one of all topics."""
        states = {topic.state for topic in self._topics.values()}
        return "moving" if "moving" in states else "zeroing" if "zeroing" in states else "idle"

    @property
    def owes(self) -> bool:
        """Whether a zero is due that could not be sent yet; it goes before any command."""
        return any(t.state == "zeroing" and not t.has_begun for t in self._topics.values())

    def is_moving(self, name: str) -> bool:
        """Return whether the last command on this topic moves the robot."""
        return self._is(name, "moving")

    def is_at_rest(self, name: str) -> bool:
        """Return whether the last command on this topic was zero, and the robot has got its zeros."""
        return name not in self._topics or self._is(name, "idle")

    def moving(self) -> list[str]:
        """Name the topics whose last command moves the robot."""
        return [name for name, topic in self._topics.items() if topic.state == "moving"]

    def commanded(self, name: str, now: float, *, moves: bool) -> None:
        """Note that a command was sent; one that does not move ends the motion."""
        topic = self._topics.setdefault(name, _Phase())
        topic.state, topic.due = ("moving", now + self.timeout_s) if moves else ("idle", 0.0)

    def stop(self, names: Iterable[str], now: float) -> None:
        """Begin the zeros on those of `names` that move."""
        self.force([name for name in names if self._is(name, "moving")], now)

    def force(self, names: Iterable[str], now: float) -> None:
        """Begin the zeros on `names`, whatever they do."""
        for name in names:
            self._topics[name] = _Phase("zeroing", now)

    def due(self, now: float) -> list[str]:
        """Name the topics that get a zero now. `zeroed` or `postponed` must follow for each."""
        silent = [name for name in self.moving() if self._topics[name].due <= now]
        self.silences += bool(silent)
        self.force(silent, now)
        return [n for n, t in self._topics.items() if t.state == "zeroing" and t.due <= now]

    def forget(self, names: Container[str]) -> None:
        """Forget the topics that are at rest and not among `names`."""
        idle_names = [n for n in self._topics if n not in names and self.is_at_rest(n)]
        for name in idle_names:
            del self._topics[name]

    def zeroed(self, name: str, now: float) -> None:
        """Note that a zero was sent."""
        topic = self._topics.get(name)
        if topic is None or topic.state != "zeroing":
            return
        topic.due, topic.left, topic.has_begun = now + ZERO_EVERY_S, topic.left - 1, True
        if topic.left == 0:
            topic.state = "idle"

    def postponed(self, name: str, now: float) -> None:
        """Note that a zero could not be sent; it is due again soon."""
        if name in self._topics:
            self._topics[name].due = now + ZERO_EVERY_S

    def hurry(self, now: float) -> None:
        """Make due what is owed: it can be sent again."""
        for topic in self._topics.values():
            if topic.state == "zeroing" and not topic.has_begun:
                topic.due = min(topic.due, now)

    def restart_zeros(self) -> None:
        """Begin the zeros anew, as nobody knows which arrived on a connection that is lost; the next one gets more."""
        for topic in self._topics.values():
            topic.left, topic.has_begun = ZEROS_AFTER_RECONNECT, False

    def next_at(self) -> float | None:
        """Return when `due` must be asked next, or None: only after another event."""
        times = [topic.due for topic in self._topics.values() if topic.state != "idle"]
        return min(times, default=None)

    def _is(self, name: str, state: State) -> bool:
        return name in self._topics and self._topics[name].state == state


@dataclass(frozen=True)
class Driven:
    """A drive topic as it was driven; `type` as it was advertised, or empty."""

    topic: str
    shape: Shape
    type: str = ""
    frame_id: str = ""


class MotionFile:
    """The motion file of a robot that may move; one of a guard before this one stays until it is adopted."""

    def __init__(self, run_dir: Path) -> None:
        self._path = run_dir / MOTION_FILE
        # What this guard has in the file.
        self._recorded: dict[str, Driven] = {}
        self._remove_at = 0.0

    def read(self) -> list[Driven] | None:
        """Return what was driven when the last guard ended: None nothing, an empty list something unknown."""
        try:
            text = read_text(self._path)
            return None if text is None else _driven(parse_object(text, MOTION_FILE))
        except (StateUnusableError, FieldError) as error:
            log.warning("%s cannot be read: %s", self._path, error)
            return []

    def write(self, driven: Sequence[Driven]) -> None:
        """Write these topics; StateUnusableError when that fails."""
        text = json.dumps({"topics": [asdict(topic) for topic in driven]}) + "\n"
        # Not synced to the disk, which would hold the first command up: it must outlive the process only.
        new = self._path.with_suffix(".new")
        try:
            new.write_text(text, encoding="utf-8")
            new.replace(self._path)
        except OSError as error:
            raise disk_problem(f"cannot write {self._path}", self._path.parent, error) from error

    def remove(self) -> None:
        """Remove the file; StateUnusableError when that fails."""
        remove(self._path)

    @property
    def ends_at(self) -> float | None:
        """When the file of a robot at rest is removed; None: there is none."""
        return self._remove_at if self._recorded else None

    def adopt(self, driven: Iterable[Driven]) -> None:
        """Keep what the last guard left as this one's own."""
        self._recorded = {entry.topic: entry for entry in driven}

    def ensure(self, moving: Driven, names: Container[str]) -> None:
        """Write that a topic moves, before it does, without others than `names`; StateUnusableError when that fails."""
        if self._recorded.get(moving.topic) == moving:
            return
        others = {name: entry for name, entry in self._recorded.items() if name in names}
        recorded = {**others, moving.topic: moving}
        self.write(list(recorded.values()))
        self._recorded = recorded

    def tend(self, now: float, *, moves: bool) -> None:
        """Remove the file when the robot has been at rest for a while."""
        if moves or not self._recorded:
            self._remove_at = now + REMOVED_AFTER_S
        elif now >= self._remove_at:
            self.end(now)

    def end(self, now: float) -> None:
        """Remove the file: the robot is at rest. Another guard's file, which this one never took over, stays."""
        if not self._recorded:
            return
        try:
            self.remove()
            self._recorded = {}
        except StateUnusableError as problem:
            log.warning("%s", problem)
            self._remove_at = now + REMOVED_AFTER_S


def _driven(file: JsonObject) -> list[Driven]:
    topics = file.get("topics")
    if not isinstance(topics, list):
        raise FieldError("field topics must be a list")
    return [_topic(as_object(topic, "a topic")) for topic in topics]


def _topic(fields: JsonObject) -> Driven:
    shape, type_name = get_text(fields, "shape"), get_text(fields, "type")
    if shape not in (*SHAPES.values(), "unknown") or (type_name and type_name not in SHAPES):
        raise FieldError(f"{shape!r} or {type_name!r} is not a drive type")
    name = full_name(get_match(fields, "topic", NAME, "a topic's name"))
    if name is None:
        raise FieldError("field topic is too long")
    frame_id = get_text(fields, "frame_id", default="", limit=MAX_FRAME_ID_LENGTH)
    return Driven(name, shape, type_name, frame_id)

"""The JSON lines between agent and guard: requests of the agent, reports of the guard.

Used by the guard's process. An agent that does not read must not hold the guard up: beyond the pipe's size and a
bound, lines are dropped, and the agent ends a silent guard. A driver must not be able to make more lines
than the server takes of a robot, which would end its session.
"""

from __future__ import annotations

import asyncio
import math
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

from robotether_common.frames import SEQUENCES
from robotether_common.guard import DEFAULT_MS, DEFAULT_TOPICS, TIMES_MS, RefusedKind, StopCause
from robotether_common.ros import MAX_GLOBS
from robotether_common.session import MAX_FENCE

from robotether_agent.fields import (
    FieldError,
    JsonObject,
    get_flag,
    get_int,
    get_match,
    get_number,
    get_object,
    get_text,
    get_texts,
    line_of,
    parse_object,
)
from robotether_agent.guard.drive_messages import DriveLimits, DriveTopics
from robotether_agent.guard.seen_age import BlindLimits, SeenAges

MAX_LIMIT = 1e6
# Minimum of what a robot may move unseen, in m or degrees; nothing at all would be no limit but a stop.
MIN_BLIND = 0.001
MAX_CAMERA_MS = 5000
ROSBRIDGE_URL = re.compile(r"wss?://\S{1,500}")
MAX_KEY_LENGTH = 500
# Maximum length of a name: the server ends the session of a robot that reports a longer one.
MAX_BY_LENGTH = 63
MAX_CAMERA_LENGTH = 256
# Maximum time in ms of the robot's clock, of one that has run for 30 years.
MAX_UPTIME_MS = 1e12
MAX_QUEUE_BYTES = 16 * 1024
MOTION_EVERY_S = 0.1
COUNTS_EVERY_S = 1.0
# Minimum interval between reports of how old is what the driver sees.
SEEN_EVERY_S = 0.5
UNHEARD = "rosapi names no node that listens to"
LISTENERS_UNKNOWN = (
    "it is unknown whether anything on the robot listens to what is driven: rosapi no longer answers, or names nobody"
    " but rosbridge; after a restart of roscore nothing listens until rosbridge is restarted"
)


@dataclass(frozen=True)
class GuardConfig:
    """What is in force; without a key nobody but direct connections gets in."""

    rosbridge_url: str
    key: str = field(default="", repr=False)
    topics: DriveTopics = field(default_factory=lambda: DriveTopics(DEFAULT_TOPICS))
    deadman_s: float = DEFAULT_MS / 1000
    max_age_s: float = DEFAULT_MS / 1000
    limits: DriveLimits = field(default_factory=DriveLimits)
    blind: BlindLimits = field(default_factory=BlindLimits)
    direct: bool = False


@dataclass(frozen=True)
class Tick:
    """The agent is alive."""


@dataclass(frozen=True)
class SessionIs:
    """The session with the server is up, or is lost."""

    up: bool


@dataclass(frozen=True)
class LeaseUpdate:
    """The server's newest number of a lease."""

    fence: int
    held: bool


@dataclass(frozen=True)
class StopRequest:
    """Somebody stops the robot."""

    id: str
    by: str


@dataclass(frozen=True)
class ReleaseRequest:
    """Somebody lets it drive again."""

    id: str
    by: str


@dataclass(frozen=True)
class FrameSent:
    """A frame leaves the robot; `taken_ms` is on the robot's clock."""

    camera: str
    frame: int
    taken_ms: float


@dataclass(frozen=True)
class Exit:
    """Stop the robot, then end."""


AgentMessage = (
    GuardConfig | Tick | SessionIs | LeaseUpdate | StopRequest | ReleaseRequest | FrameSent | Exit
)


def parse(line: bytes) -> AgentMessage | None:
    """Return what a line says, None for a type that a newer agent may know; FieldError if it is broken."""
    fields = parse_object(line, "a line of the agent")
    reader = READERS.get(get_text(fields, "type", limit=50))
    return None if reader is None else reader(fields)


def _session(fields: JsonObject) -> SessionIs:
    return SessionIs(get_flag(fields, "up", default=False))


def _lease(fields: JsonObject) -> LeaseUpdate:
    return LeaseUpdate(
        get_int(fields, "fence", 0, MAX_FENCE), get_flag(fields, "held", default=False)
    )


def _frame(fields: JsonObject) -> FrameSent:
    return FrameSent(
        get_text(fields, "camera", limit=MAX_CAMERA_LENGTH),
        get_int(fields, "frame", 0, SEQUENCES - 1),
        get_number(fields, "taken_ms", 0, MAX_UPTIME_MS),
    )


def _stop(fields: JsonObject) -> StopRequest:
    # A stop counts even if it does not say whose it is.
    return StopRequest(get_text(fields, "id", default=""), _by(fields))


def _release(fields: JsonObject) -> ReleaseRequest:
    return ReleaseRequest(get_text(fields, "id"), _by(fields))


def _by(fields: JsonObject) -> str:
    return get_text(fields, "by", default="", limit=MAX_BY_LENGTH)


def _config(fields: JsonObject) -> GuardConfig:
    url = get_match(fields, "rosbridge_url", ROSBRIDGE_URL, "a WebSocket's URL")
    direct = get_flag(fields, "direct", default=False)
    if fields.get("guard") is None:
        return GuardConfig(url, direct=direct)
    guard = get_object(fields, "guard")
    values = {name: value for name, value in guard.items() if value is not None}
    return GuardConfig(
        url,
        key=get_text(values, "key", default="", limit=MAX_KEY_LENGTH),
        topics=_topics(values),
        deadman_s=_seconds(values, "deadman_ms"),
        max_age_s=_seconds(values, "max_age_ms"),
        limits=DriveLimits(
            max_speed_m_s=_limit(values, "max_speed_m_s"),
            max_turn_rad_s=_limit(values, "max_turn_rad_s"),
            max_acceleration_m_s2=_limit(values, "max_acceleration_m_s2"),
            max_turn_acceleration_rad_s2=_limit(values, "max_turn_acceleration_rad_s2"),
            max_steering_rad=_limit(values, "max_steering_rad"),
        ),
        blind=_blind(values),
        direct=direct,
    )


def _blind(guard: JsonObject) -> BlindLimits:
    degrees = _limit(guard, "blind_deg", MIN_BLIND)
    return BlindLimits(
        blind_m=_limit(guard, "blind_m", MIN_BLIND),
        blind_rad=None if degrees is None else math.radians(degrees),
        camera_s=get_number({"camera_ms": 0, **guard}, "camera_ms", 0, MAX_CAMERA_MS) / 1000,
        needs_frames=get_text(guard, "without_frames", default="unlimited") != "unlimited",
    )


def _topics(guard: JsonObject) -> DriveTopics:
    if "drive_topics" not in guard:
        return DriveTopics(DEFAULT_TOPICS)
    if guard["drive_topics"] == []:
        return DriveTopics(())
    patterns = get_texts(guard, "drive_topics", limit=MAX_GLOBS)
    try:
        return DriveTopics(patterns)
    except ValueError as error:
        raise FieldError(f"field drive_topics: {error}") from error


def _seconds(guard: JsonObject, name: str) -> float:
    return get_number({name: DEFAULT_MS, **guard}, name, *TIMES_MS) / 1000


def _limit(guard: JsonObject, name: str, low: float = 0) -> float | None:
    return get_number(guard, name, low, MAX_LIMIT) if name in guard else None


READERS: Mapping[str, Callable[[JsonObject], AgentMessage]] = {
    "config": _config,
    "session": _session,
    "lease": _lease,
    "stop": _stop,
    "release": _release,
    "frame": _frame,
    "tick": lambda _: Tick(),
    "exit": lambda _: Exit(),
}


@dataclass(frozen=True)
class State:
    """What is reported when it changes."""

    stopped: bool
    by: str
    moving: bool
    # The newest number of a lease, 0: none.
    fence: int
    # Drive topics that are UNHEARD; None: unknown (LISTENERS_UNKNOWN).
    unheard: tuple[str, ...] | None = ()


class GuardReporter:
    """The lines to the agent."""

    def __init__(
        self, pipe: asyncio.WriteTransport, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._pipe = pipe
        self._clock = clock
        self._sent: State | None = None
        self._sent_counts: tuple[Mapping[RefusedKind, int], Mapping[StopCause, int]] = ({}, {})
        self._sent_at = 0.0
        self._seen_at = -SEEN_EVERY_S

    def ready(self, port: int) -> None:
        """Report where the guard listens."""
        self._line({"type": "ready", "port": port})

    def tick(self) -> None:
        """Report that the guard is alive."""
        self._line({"type": "tick"})

    def seen(self, ages: SeenAges) -> None:
        """Report how old was what the driver saw, now and then, and empty `ages`."""
        now = self._clock()
        if not ages.has_news or now - self._seen_at < SEEN_EVERY_S:
            return
        if self._line({"type": "seen", **ages.report()}):
            self._seen_at = now
            ages.clear()

    def state(
        self,
        state: State,
        refused: Mapping[RefusedKind, int],
        stops: Mapping[StopCause, int],
        *,
        answers: str | None = None,
    ) -> None:
        """Report the state if it or a count is another than was sent last, or if it `answers` a stop or a release.

        Call it now and then also when nothing changed: counts and the end of a short motion may be reported later.
        """
        counts = (dict(refused), dict(stops))
        if answers is None and self._can_wait(state, counts):
            return
        line = {
            "type": "guard",
            "state": "ready",
            **asdict(state),
            # An older guard ignores `blind_m` and `blind_deg`, and lacks this.
            "blind_limits": True,
            "answers": answers,
            "refused": counts[0],
            "stops": counts[1],
        }
        if self._line(line):
            self._sent, self._sent_at = state, self._clock()
            self._sent_counts = counts

    def _can_wait(self, state: State, counts: object) -> bool:
        sent, since_s = self._sent, self._clock() - self._sent_at
        if state == sent:
            return counts == self._sent_counts or since_s < COUNTS_EVERY_S
        if sent is None or state != replace(sent, moving=False):
            return False
        return since_s < MOTION_EVERY_S

    def _line(self, fields: Mapping[str, object]) -> bool:
        if self._pipe.is_closing() or self._pipe.get_write_buffer_size() > MAX_QUEUE_BYTES:
            return False
        self._pipe.write(line_of(fields))
        return True

"""Finds drive messages among all that operators send, reads their commands field by field, and limits these.

The client proxy asks `drive_message` about every message of every connection. What it lets pass goes to rosbridge as
the bytes that came, so it must read them as rosbridge does: what could be read in two ways is refused. rosbridge, when
it cannot parse a message as a whole, runs an operation that it finds inside; so none that the guard cares for may
be inside another one.

The drive controller sends what `write_command` makes of a checked command, and nothing else, so nothing reaches the
wheels that this module does not know. Braking is never limited: no command leaves `limited` faster than it came, and
one that asks for less speed than the robot has in that direction passes at once. Pure; fuzzed by tests/fuzz.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, NoReturn, cast

from robotether_common.guard import MAX_NUMBER, STAMP, RefusedKind, count_values
from robotether_common.ros import (
    ACKERMANN,
    ACKERMANN_RATES,
    ACKERMANN_STAMPED,
    AXES,
    MAX_GLOB_LENGTH,
    TWIST,
    TWIST_STAMPED,
    Globs,
    full_name,
)

from robotether_agent.fields import printable
from robotether_agent.problems import DetailError

Operation = Literal["publish", "advertise", "unadvertise"]
MessageId = str | int | None
# Of an unknown topic only the zero can be written: the empty message, which rosbridge completes by the topic's type.
Shape = Literal["twist", "twist_stamped", "ackermann", "unknown"]
Vector = tuple[float, float, float]

PATTERN = re.compile(rf"[A-Za-z0-9_/*]{{1,{MAX_GLOB_LENGTH}}}")
MAX_ID_LENGTH = 256
# Maximum number of names of which it is cached whether they are drive topics; clients use few.
KNOWN_NAMES = 256
# Maximum number of values in a message; reading them delays the zeros by up to 0.1 s, on a small
# computer by 0.4 s.
MAX_VALUES = 200_000

ON_TOPICS = ("publish", "advertise", "unadvertise")
# They hide other operations.
WRAPPERS = ("fragment", "png")
GUARDED = frozenset((*ON_TOPICS, *WRAPPERS))

STANDSTILL: Vector = (0.0, 0.0, 0.0)
MAX_FRAME_ID_LENGTH = 255
SHAPES: Mapping[str, Shape] = {
    "geometry_msgs/Twist": "twist",
    "geometry_msgs/msg/Twist": "twist",
    "geometry_msgs/TwistStamped": "twist_stamped",
    "geometry_msgs/msg/TwistStamped": "twist_stamped",
    "ackermann_msgs/AckermannDriveStamped": "ackermann",
    "ackermann_msgs/msg/AckermannDriveStamped": "ackermann",
}
_MEMBERS: Mapping[Shape, frozenset[str]] = {
    "twist": TWIST,
    "twist_stamped": TWIST_STAMPED,
    "ackermann": ACKERMANN_STAMPED,
    "unknown": frozenset(),
}
_STAMP_MEMBERS = frozenset({"secs", "nsecs", "sec", "nanosec"})
MAX_WHOLE = 2**63 - 1
# Maximum time between commands that counts for acceleration: the robot must not catch up after a
# pause.
MAX_STEP_S = 0.1


class DriveMessageRefusedError(DetailError):
    """Raised by every check, counted and answered; `why` goes on where "cannot DO WHAT: " ends."""

    def __init__(self, kind: RefusedKind, why: str) -> None:
        super().__init__(why)
        self.kind = kind
        self.why = why


class DriveMessageUnclearError(DriveMessageRefusedError):
    """A message that cannot be checked; `message_id` is its own, for the answer."""

    def __init__(self, why: str, message_id: MessageId = None) -> None:
        super().__init__("shape", why)
        self.message_id = message_id


class DriveTopics:
    """The robot's drive topics: patterns for their full names."""

    def __init__(self, patterns: Sequence[str]) -> None:
        for pattern in patterns:
            if not PATTERN.fullmatch(pattern):
                raise ValueError(f"{pattern[:80]!r} is not a name of a topic, with * for any text")
        self.patterns = tuple(patterns)
        # Whether a full name is a drive topic's.
        self.match = lru_cache(KNOWN_NAMES)(Globs(patterns).match)
        self._last_parts = Globs(pattern.rpartition("/")[2] for pattern in patterns)

    def might_be(self, relative: str) -> bool:
        """Return whether a name without a first slash could be a drive topic's in some namespace of the robot."""
        return self._last_parts.match(relative.rpartition("/")[2])

    def plain(self) -> list[str]:
        """Return those that are names and no patterns."""
        return [pattern for pattern in self.patterns if "*" not in pattern]


@dataclass(frozen=True)
class DriveMessage:
    """An operation on a drive topic; `fields` are the message's own, not looked at yet."""

    operation: Operation
    topic: str
    fields: Mapping[str, Any]


def message_id(fields: Mapping[str, Any]) -> MessageId:
    """Return what an answer to this message refers to."""
    value = fields.get("id")
    if isinstance(value, str) and len(value) <= MAX_ID_LENGTH:
        return value
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def drive_message(data: bytes, topics: DriveTopics) -> DriveMessage | None:
    """Return the operation on a drive topic, or None: the message may pass unchanged.

    Unclear when neither can be said.
    """
    fields = _parse(data)
    operation = fields.get("op")
    if not isinstance(operation, str):
        raise DriveMessageUnclearError("its op is not text", message_id(fields))
    if operation in WRAPPERS:
        raise DriveMessageUnclearError(f"the guard cannot check {operation}", message_id(fields))
    if operation not in ON_TOPICS:
        return None
    topic = _topic(fields, topics)
    return None if topic is None else DriveMessage(cast("Operation", operation), topic, fields)


def _topic(fields: Mapping[str, Any], topics: DriveTopics) -> str | None:
    name = fields.get("topic")
    full = full_name(name)
    if full is None:
        excerpt = printable(str(name), 80)
        raise DriveMessageUnclearError(f"{excerpt!r} is not a name like /a/b_1", message_id(fields))
    if topics.match(full):
        return full
    if name != full and topics.might_be(full[1:]):
        raise DriveMessageUnclearError(
            f"{name!r} may be a drive topic; write its full name", message_id(fields)
        )
    if STAMP in fields:
        # The relay stamps drive commands only: its settings and these may differ for a while.
        raise DriveMessageUnclearError(
            f"{full} is a drive topic for the server, but not here", message_id(fields)
        )
    return None


class _Parser:
    """Parses one message at a time; not for threads."""

    def __init__(self) -> None:
        self._guarded = 0
        self._decoder = json.JSONDecoder(
            object_pairs_hook=self._object, parse_constant=_no_constant
        )

    def parse(self, text: str) -> object:
        self._guarded = 0
        value = self._decoder.decode(text)
        outermost = isinstance(value, dict) and _is_guarded(value)
        if self._guarded > outermost:
            raise DriveMessageUnclearError("it has an operation inside another one")
        return value

    def _object(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        obj = dict(pairs)
        if len(obj) != len(pairs):
            raise DriveMessageUnclearError("a key appears twice")
        self._guarded += _is_guarded(obj)
        return obj


def _parse(data: bytes) -> Mapping[str, Any]:
    if count_values(data) > MAX_VALUES:
        raise DriveMessageUnclearError(f"it has over {MAX_VALUES} values, the guard's limit")
    try:
        value = _parser.parse(data.decode())
    except (ValueError, RecursionError) as error:
        raise DriveMessageUnclearError(f"it is not JSON: {printable(str(error), 120)}") from error
    if not isinstance(value, dict):
        raise DriveMessageUnclearError("it is not a JSON object")
    return value


def _is_guarded(value: Mapping[str, Any]) -> bool:
    operation = value.get("op")
    return isinstance(operation, str) and operation in GUARDED


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"JSON has no {text}")


_parser = _Parser()


@dataclass(frozen=True)
class CheckedCommand:
    """A checked command in m/s, rad/s and rad. An Ackermann speed is linear[0]; rates are as in its message."""

    shape: Shape
    linear: Vector = STANDSTILL
    angular: Vector = STANDSTILL
    steering: float = 0.0
    rates: Vector = STANDSTILL
    frame_id: str = ""

    @property
    def moves(self) -> bool:
        """Return whether the robot is to move; some that steer like cars follow the rates alone."""
        return any(self.linear) or any(self.angular) or any(self.rates)


def zero(shape: Shape, frame_id: str = "") -> CheckedCommand:
    """Return the zero command."""
    has_header = shape in ("twist_stamped", "ackermann")
    return CheckedCommand(shape, frame_id=frame_id if has_header else "")


def read_command(message: object, declared: Shape | None) -> CheckedCommand:
    """Return the command in the `msg` of a publish; its shape decides, and `declared` only when it has none."""
    members = _object(message, "msg")
    shape = _shape(members) or declared
    if shape is None:
        raise DriveMessageRefusedError(
            "shape", "its msg is not a Twist, TwistStamped or AckermannDriveStamped"
        )
    _only(members, _MEMBERS[shape], "msg")
    if shape == "twist":
        return _twist(shape, members, "")
    frame_id = _frame_id(members.get("header"))
    if shape == "twist_stamped":
        return _twist(shape, _object(members.get("twist", {}), "twist"), frame_id)
    return _ackermann(_object(members.get("drive", {}), "drive"), frame_id)


def write_command(command: CheckedCommand) -> dict[str, Any]:
    """Return the `msg` that says what `command` says."""
    if command.shape == "unknown":
        return {}
    if command.shape == "ackermann":
        drive = {"steering_angle": command.steering, "speed": command.linear[0]}
        drive |= dict(zip(ACKERMANN_RATES, command.rates, strict=True))
        return _stamped(command, {"drive": drive})
    twist = {"linear": _written(command.linear), "angular": _written(command.angular)}
    return twist if command.shape == "twist" else _stamped(command, {"twist": twist})


def _shape(members: Mapping[str, Any]) -> Shape | None:
    if "twist" in members:
        return "twist_stamped"
    if "drive" in members:
        return "ackermann"
    return "twist" if "linear" in members or "angular" in members else None


def _twist(shape: Shape, members: Mapping[str, Any], frame_id: str) -> CheckedCommand:
    _only(members, _MEMBERS["twist"], "twist")
    linear, angular = _vector(members, "linear"), _vector(members, "angular")
    return CheckedCommand(shape, linear, angular, frame_id=frame_id)


def _ackermann(members: Mapping[str, Any], frame_id: str) -> CheckedCommand:
    _only(members, ACKERMANN, "drive")
    first, second, third = (_number(members, name) for name in ACKERMANN_RATES)
    return CheckedCommand(
        "ackermann",
        (_number(members, "speed"), 0.0, 0.0),
        steering=_number(members, "steering_angle"),
        rates=(first, second, third),
        frame_id=frame_id,
    )


def _frame_id(value: object) -> str:
    """Return the frame that a header names, which is checked as a whole."""
    header = _object({} if value is None else value, "header")
    _only(header, frozenset({"seq", "stamp", "frame_id"}), "header")
    frame_id = header.get("frame_id", "")
    # Half a character is not printable, and ROS cannot take it.
    if (
        not isinstance(frame_id, str)
        or len(frame_id) > MAX_FRAME_ID_LENGTH
        or not frame_id.isprintable()
    ):
        raise DriveMessageRefusedError("shape", "its frame_id is not a short printable text")
    stamp = header.get("stamp", {})
    if stamp != "now":
        stamp = _object(stamp, "stamp")
        _only(stamp, _STAMP_MEMBERS, "stamp")
        _whole(stamp)
    _whole({"seq": header.get("seq", 0)})
    return frame_id


def _whole(members: Mapping[str, Any]) -> None:
    for name, value in members.items():
        if type(value) is not int or not 0 <= value <= MAX_WHOLE:
            raise DriveMessageRefusedError("shape", f"its {name} is not a whole number from 0")


def _vector(members: Mapping[str, Any], name: str) -> Vector:
    axes = _object(members.get(name, {}), name)
    _only(axes, frozenset(AXES), name)
    return (_number(axes, "x"), _number(axes, "y"), _number(axes, "z"))


def _number(members: Mapping[str, Any], name: str) -> float:
    value = members.get(name, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DriveMessageRefusedError("shape", f"its {name} is not a number")
    # An integer may be too large for a float, so it is compared first.
    if not -MAX_NUMBER <= value <= MAX_NUMBER or not math.isfinite(value):
        raise DriveMessageRefusedError(
            "shape", f"its {name} is not a number that a robot can execute"
        )
    return float(value)


def _object(value: object, name: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise DriveMessageRefusedError("shape", f"its {name} is not an object")
    return value


def _only(members: Mapping[str, Any], names: frozenset[str], name: str) -> None:
    if not members.keys() <= names:
        raise DriveMessageRefusedError("shape", f"its {name} has members that no drive message has")


def _written(vector: Vector) -> dict[str, float]:
    return dict(zip(AXES, vector, strict=True))


def _stamped(command: CheckedCommand, members: dict[str, Any]) -> dict[str, Any]:
    # Neither stamp nor seq: rosbridge writes the robot's own time there. A client's may be of the other ROS,
    # so that the robot does not take a zero, or so far ahead that its controller never calls a command old.
    return {"header": {"frame_id": command.frame_id}, **members}


@dataclass(frozen=True)
class DriveLimits:
    """None is no limit."""

    max_speed_m_s: float | None = None
    max_turn_rad_s: float | None = None
    max_acceleration_m_s2: float | None = None
    max_turn_acceleration_rad_s2: float | None = None
    max_steering_rad: float | None = None


def limited(
    command: CheckedCommand, before: CheckedCommand | None, step_s: float, limits: DriveLimits
) -> CheckedCommand:
    """Return `command` within `limits`, `step_s` after `before`; None: the robot is at rest."""
    step_s = min(max(step_s, 0.0), MAX_STEP_S)
    linear, angular = (before.linear, before.angular) if before else (STANDSTILL, STANDSTILL)
    return replace(
        command,
        linear=_limited_vector(
            command.linear, linear, limits.max_speed_m_s, limits.max_acceleration_m_s2, step_s
        ),
        angular=_limited_vector(
            command.angular,
            angular,
            limits.max_turn_rad_s,
            limits.max_turn_acceleration_rad_s2,
            step_s,
        ),
        steering=_limited_scalar(command.steering, limits.max_steering_rad),
        rates=_limited_rates(command.rates, limits.max_acceleration_m_s2),
    )


def slowed(command: CheckedCommand, speed: float, turn: float) -> CheckedCommand:
    """Return `command` with at most this speed in m/s and turn in rad/s, in its direction."""
    return replace(
        command,
        linear=_limited_vector(command.linear, STANDSTILL, speed, None, 0.0),
        angular=_limited_vector(command.angular, STANDSTILL, turn, None, 0.0),
    )


def _limited_vector(
    command: Vector, before: Vector, most: float | None, growth: float | None, step_s: float
) -> Vector:
    length = math.hypot(*command)
    allowed = length if most is None else min(length, most)
    if growth is not None and length > 0:
        allowed = min(allowed, _along(before, command, length) + growth * step_s)
    return command if allowed >= length else _scaled(command, allowed / length)


def _along(before: Vector, command: Vector, length: float) -> float:
    """Return how fast the robot is in the wanted direction already; the other way counts as at rest."""
    return max(0.0, sum(old * (new / length) for old, new in zip(before, command, strict=True)))


def _scaled(vector: Vector, factor: float) -> Vector:
    x, y, z = vector
    return (x * factor, y * factor, z * factor)


def _limited_rates(rates: Vector, most: float | None) -> Vector:
    """Return an Ackermann message's rates with at most `most` m/s² of acceleration."""
    steering, acceleration, jerk = rates
    return (steering, _limited_scalar(acceleration, most), jerk)


def _limited_scalar(value: float, most: float | None) -> float:
    return value if most is None else max(-most, min(most, value))

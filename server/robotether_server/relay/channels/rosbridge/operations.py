"""What a client's message may hold: strict JSON, an operation of the list, and fields that are checked one by one.

`OPERATIONS` lists what a connection may send, with its fields; the documents' page of operations is made from it. A
check returns the value to send on, and raises FieldRefusedError with the reason. What passes has one meaning to every
JSON parser; except in messages and payloads it has no object in which a confused parser could find an operation. Pure.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec
from robotether_common.frames import SEQUENCES
from robotether_common.guard import MAX_NUMBER, MAX_SEEN_FRAMES, STAMP
from robotether_common.ros import (
    ACKERMANN,
    ACKERMANN_STAMPED,
    AXES,
    MAX_NAME_LENGTH,
    TWIST,
    TWIST_STAMPED,
    full_name,
)

from robotether_server.contract.control import press_of
from robotether_server.contract.ros import MAX_THROTTLE_MS
from robotether_server.problems import RobotetherError
from robotether_server.relay.channels.rosbridge.drive_path import DriveStamp
from robotether_server.relay.robots.delivered_frames import NamedFrame

Check = Callable[[Any], object]
# Whose globs of the level's policy the operation's name must match.
Right = Literal["subscribe", "publish", "call", "serve"]

# Maximum depth of a message; those of ROS have fewer than ten levels.
MAX_DEPTH = 64
# What signed and unsigned integers of ROS hold.
MIN_INTEGER, MAX_INTEGER = -(2**63), 2**64 - 1
_MANY_DIGITS = b"0" * 19
_DIGITS = bytes(ord("0") if byte in b"0123456789" else 0 for byte in range(256))
_DECODER = msgspec.json.Decoder()
# Writes what was read and checked, so that every parser reads it alike.
write_json = msgspec.json.Encoder().encode

LEVELS = ("info", "warning", "error", "none")
# Of several of one client rosbridge takes the last.
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
MAX_QUEUE = 1000
# Maximum time limit of a call; one that is not positive is none.
MAX_CALL_S = 86_400
# Minimum and maximum size of a fragment; in a smaller one most bytes would be the fragment's own
# frame.
FRAGMENT_BYTES = (100, 2**31 - 1)
STATUS_CODES = (-128, 127)
MAX_TEXT_LENGTH = 1024
# Parsers written in C refuse what is longer, or make a float of it.
WHOLE_64_BIT = (-(2**63), 2**63 - 1)
# Whole numbers that are the same as floats.
WHOLE_53_BIT = (-(2.0**53), 2.0**53)
# A field of a ROS message; `op` would make an operation of the object that contains it.
FIELD_NAME = re.compile(r"(?!op\Z)[A-Za-z][A-Za-z0-9_]{0,63}")
_AXES = frozenset(AXES)
# True is a number to Python only.
_NUMBERS = frozenset((int, float))


class NotJsonError(RobotetherError):
    """A message is not a JSON object, or none that all parsers read alike; the text says why."""


def read_json(data: bytes) -> dict[str, Any]:
    """Return the one JSON object in UTF-8 that the message is, of a key twice the last; raise NotJsonError.

    Some robots' parsers refuse what others take (deep nesting, NaN, numbers over 64 bits, half characters), and
    rosbridge, when it cannot parse a message as a whole, runs any object with an `op` that it finds inside. So nothing
    that a parser may refuse is read.
    """
    try:
        message = _DECODER.decode(data)
    except RecursionError as exc:
        raise NotJsonError("it is nested too deep") from exc
    except UnicodeDecodeError as exc:
        raise NotJsonError("it is not UTF-8") from exc
    except msgspec.ValidationError as exc:
        raise NotJsonError("a number in it is too large") from exc
    except msgspec.DecodeError as exc:
        raise NotJsonError(str(exc).removeprefix("JSON is malformed: ")) from exc
    if not isinstance(message, dict):
        raise NotJsonError("it is not an object")
    # Fewer brackets than that cannot nest deeper, and fewer digits are within 64 bits.
    many_brackets = data.count(b"{") + data.count(b"[") > MAX_DEPTH
    if many_brackets or _MANY_DIGITS in data.translate(_DIGITS):
        _check_inside(message)
    return message


def _check_inside(message: dict[str, Any]) -> None:
    """Raise NotJsonError when it nests too deep, or for a whole number of more than 64 bits."""
    level: list[Any] = [message]
    for _ in range(MAX_DEPTH):
        values = [
            value
            for outer in level
            for value in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if any(
            isinstance(value, int) and not MIN_INTEGER <= value <= MAX_INTEGER for value in values
        ):
            raise NotJsonError("a number in it has more than 64 bits")
        level = [value for value in values if isinstance(value, (dict, list))]
        if not level:
            return
    raise NotJsonError(f"it is nested more than {MAX_DEPTH} deep")


class FieldRefusedError(RobotetherError):
    """A field may not go on; the text goes on where its name ends: "is ..."."""


def text(value: Any) -> str:
    """Pass a text of bounded length."""
    if not isinstance(value, str) or len(value) > MAX_TEXT_LENGTH:
        raise FieldRefusedError(f"is not text of up to {MAX_TEXT_LENGTH} characters")
    return value


def ros_name(value: Any) -> str:
    """Pass the name of a topic, service or action, with the first slash that it may lack."""
    name = full_name(value)
    if name is None:
        raise FieldRefusedError(
            f"is not a full name such as /a/b_1, of up to {MAX_NAME_LENGTH} characters"
        )
    return name


def served_name(value: Any) -> str:
    """Pass the whole name of what a client serves: what the robot sends it comes under that name alone."""
    name = ros_name(value)
    if name != value:
        raise FieldRefusedError(f"must be the whole name {name}")
    return name


def flag(value: Any) -> bool:
    """Pass a truth value."""
    if not isinstance(value, bool):
        raise FieldRefusedError("is neither true nor false")
    return value


def whole(low: int, high: int) -> Callable[[Any], int]:
    """Make a check for whole numbers from `low` to `high`."""

    def check(value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise FieldRefusedError(f"is not a whole number from {low} to {high}")
        return value

    return check


def clamped(low: int, high: int, kind: Callable[[float], float] = round) -> Check:
    """Make a check for numbers, which passes the nearest one of a kind from `low` to `high`."""

    def check(value: Any) -> float:
        if not isinstance(value, (int, float)):
            raise FieldRefusedError("is not a number")
        return kind(min(max(value, low), high))

    return check


_frame_number = whole(0, SEQUENCES - 1)


def choice(*allowed: str) -> Check:
    """Make a check for one of some words."""

    def check(value: Any) -> str:
        for word in allowed:
            if value == word:
                return word
        raise FieldRefusedError(f"is none of {', '.join(allowed)}")

    return check


def identity(value: Any) -> str | int:
    """Pass what an answer refers to: a text or a whole number."""
    if isinstance(value, str):
        return text(value)
    return _whole_64_bit(value)


def members(value: Any) -> dict[str, Any]:
    """Pass an object of any members: a message."""
    if not isinstance(value, dict):
        raise FieldRefusedError("is not an object")
    return value


def payload(value: Any) -> dict[str, Any] | list[Any]:
    """Pass an object or array of anything: what a service or an action takes."""
    if not isinstance(value, (dict, list)):
        raise FieldRefusedError("is neither object nor array")
    return value


def answer(value: Any) -> dict[str, Any] | list[Any] | str:
    """Pass what a service answers, or in its place why it failed, as roslibjs has it."""
    return text(value) if isinstance(value, str) else payload(value)


def timestamp(value: Any) -> float:
    """Pass a time in ms."""
    low, high = WHOLE_53_BIT
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not low <= value <= high:
        raise FieldRefusedError("is not a time in ms")
    return float(value)


def stamp(value: Any) -> DriveStamp:
    """Return what stands beside `msg` of a drive command: its timestamp, the frames that were seen, or both."""
    if not isinstance(value, dict) or not value.keys() & {"t_ms", "seen"}:
        raise FieldRefusedError("is not an object with t_ms or seen")
    return DriveStamp(
        timestamp(value["t_ms"]) if "t_ms" in value else None,
        _seen(value["seen"]) if "seen" in value else None,
    )


def _seen(value: Any) -> tuple[NamedFrame, ...]:
    if not isinstance(value, list) or len(value) > MAX_SEEN_FRAMES:
        raise FieldRefusedError(
            f"has a seen that is not an array of up to {MAX_SEEN_FRAMES} frames"
        )
    return tuple(map(_named_frame, value))


def _named_frame(value: Any) -> NamedFrame:
    if not isinstance(value, dict) or not {"camera", "frame"} <= value.keys():
        raise FieldRefusedError("has a seen with what is not an object with camera and frame")
    number = None if value["frame"] is None else _frame_number(value["frame"])
    return NamedFrame(text(value["camera"]), number)


def scalars(value: Any) -> dict[str, object] | list[object]:
    """Pass an object or array of texts, numbers and truth values; nothing is nested deeper."""
    if isinstance(value, list):
        return [_scalar(item) for item in value]
    if not isinstance(value, dict):
        raise FieldRefusedError("is neither object nor array")
    return _plain_object(value)


def quality(value: Any) -> dict[str, object]:
    """Pass a QoS profile: an object of plain values, and of objects of plain values, as durations are."""
    objects = {name: each for name, each in members(value).items() if isinstance(each, dict)}
    durations = {name: _plain_object(each) for name, each in objects.items()}
    return _plain_object(value | dict.fromkeys(objects)) | durations


def _plain_object(value: dict[str, Any]) -> dict[str, object]:
    for name in value:
        if not FIELD_NAME.fullmatch(name):
            raise FieldRefusedError(f"has a member {name[:64]!r}, which may not stand here")
    return {name: _scalar(item) for name, item in value.items()}


def _scalar(value: Any) -> object:
    if value is None or isinstance(value, (bool, float)):
        return value
    if isinstance(value, str):
        return text(value)
    return _whole_64_bit(value)


def _whole_64_bit(value: Any) -> int:
    low, high = WHOLE_64_BIT
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise FieldRefusedError("holds what is neither a text nor a number of 64 bits")
    return value


def speeds(msg: Mapping[str, Any]) -> tuple[float, float | None]:
    """Return the speed in m/s and the turn in rad/s; raise FieldRefusedError when it is no command.

    The shape decides the type: geometry_msgs/Twist and TwistStamped, ackermann_msgs/AckermannDriveStamped. A member
    that is missing is zero, as it is to rosbridge.
    """
    members = msg.keys()
    if members <= TWIST:
        return _of_twist(msg)
    if members <= TWIST_STAMPED:
        return _of_twist(_object(msg.get("twist", {}), TWIST))
    if members <= ACKERMANN_STAMPED:
        drive = _object(msg.get("drive", {}), ACKERMANN)
        for value in drive.values():
            _finite(value)
        return abs(_finite(drive.get("speed", 0.0))), None
    raise FieldRefusedError(
        "is neither a Twist, a TwistStamped nor an AckermannDriveStamped, which a drive topic takes"
    )


def _of_twist(twist: Mapping[str, Any]) -> tuple[float, float]:
    return _length(twist.get("linear", {})), _length(twist.get("angular", {}))


def _length(vector: Any) -> float:
    values = _object(vector, _AXES).values()
    if not _NUMBERS.issuperset(map(type, values)):
        raise FieldRefusedError("holds a speed that is not a finite number")
    # Infinite, or no number, if one of them is.
    return _finite(math.hypot(*values))


def _object(value: Any, names: frozenset[str]) -> Mapping[str, Any]:
    if not isinstance(value, dict) or not value.keys() <= names:
        raise FieldRefusedError(f"has a part that is not an object of {', '.join(sorted(names))}")
    return value


def _finite(value: Any) -> float:
    if type(value) not in _NUMBERS or not math.isfinite(value):
        raise FieldRefusedError("holds a speed that is not a finite number")
    if abs(value) > MAX_NUMBER:
        # The guard refuses it as well. Sums of such speeds are infinite, which the record of a drive cannot hold.
        raise FieldRefusedError("holds a number that no robot can execute")
    return float(value)


@dataclass(frozen=True)
class Operation:
    """One kind of message: `says` begins the sentence of a refusal."""

    says: str
    fields: Mapping[str, Check]
    right: Right | None = None
    # The field whose name is checked against the right; it must be there.
    named_by: str | None = None
    # For the relay itself; it never reaches a robot.
    own: bool = False
    # The fields as a sequence, which is quicker to go through.
    checks: tuple[tuple[str, Check], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "checks", tuple(self.fields.items()))


_ANSWER: Mapping[str, Check] = {
    "fragment_size": clamped(*FRAGMENT_BYTES),
    "compression": choice(*COMPRESSIONS),
}
_TOPIC: Mapping[str, Check] = {
    "id": identity,
    "topic": ros_name,
    "type": text,
}
_PUBLISHED: Mapping[str, Check] = {
    "latch": flag,
    "queue_size": clamped(0, MAX_QUEUE),
    "qos": quality,
}
_GOAL: Mapping[str, Check] = {
    "id": identity,
    "action": ros_name,
    "action_type": text,
    "args": payload,
    "feedback": flag,
    **_ANSWER,
}
_SERVICE: Mapping[str, Check] = {
    "id": identity,
    "service": ros_name,
    "type": text,
    "values": answer,
    "result": flag,
}
_ACTION: Mapping[str, Check] = {
    "id": identity,
    "action": ros_name,
    "type": text,
    "values": payload,
    "status": whole(*STATUS_CODES),
    "result": flag,
}
_STATUS: Mapping[str, Check] = {
    "id": identity,
    "level": choice(*LEVELS),
    "msg": text,
}

OPERATIONS: Mapping[str, Operation] = {
    "subscribe": Operation(
        "subscribe to",
        {
            **_TOPIC,
            "throttle_rate": clamped(0, MAX_THROTTLE_MS),
            "queue_length": clamped(0, MAX_QUEUE),
            "qos": quality,
            **_ANSWER,
        },
        "subscribe",
        "topic",
    ),
    "unsubscribe": Operation(
        "unsubscribe from",
        {"id": identity, "topic": ros_name},
        "subscribe",
        "topic",
    ),
    "advertise": Operation("advertise", {**_TOPIC, **_PUBLISHED}, "publish", "topic"),
    "unadvertise": Operation("unadvertise", {**_TOPIC, **_PUBLISHED}, "publish", "topic"),
    "publish": Operation(
        "publish to",
        {**_TOPIC, "msg": members, **_PUBLISHED, STAMP: stamp},
        "publish",
        "topic",
    ),
    "call_service": Operation(
        "call",
        {
            "id": identity,
            "service": ros_name,
            "type": text,
            "args": payload,
            "timeout": clamped(-MAX_CALL_S, MAX_CALL_S, float),
            **_ANSWER,
        },
        "call",
        "service",
    ),
    "send_action_goal": Operation("send a goal to", _GOAL, "call", "action"),
    "cancel_action_goal": Operation("cancel a goal of", _GOAL, "call", "action"),
    "advertise_service": Operation(
        "serve", {**_SERVICE, "service": served_name}, "serve", "service"
    ),
    "unadvertise_service": Operation("stop serving", _SERVICE, "serve", "service"),
    "service_response": Operation("answer for", _SERVICE, "serve", "service"),
    "advertise_action": Operation("serve", {**_ACTION, "action": served_name}, "serve", "action"),
    "unadvertise_action": Operation("stop serving", _ACTION, "serve", "action"),
    "action_feedback": Operation("answer for", _ACTION, "serve", "action"),
    "action_result": Operation("answer for", _ACTION, "serve", "action"),
    "action_status": Operation("answer for", _ACTION, "serve", "action"),
    "status": Operation("send a status", _STATUS),
    "set_level": Operation("set the level", _STATUS),
    "robotether.clock_sync": Operation(
        "answer the clock sync", {"t_ms": timestamp, "key": text}, own=True
    ),
    "robotether.stop": Operation("stop the robot", {"press": press_of}, own=True),
}

# Services of rosapi that only look something up in what rosapi knows by itself; every level may call them.
_LOOKUPS = """
    action_feedback_details action_goal_details action_result_details action_servers action_type
    get_ros_version get_time interfaces message_details node_details nodes publishers
    service_providers service_request_details service_response_details services
    subscribers topic_type topics topics_for_type
"""
# Look-ups that ask other nodes or describe every type: for drivers. rosapi up to 2.1.0 waits for a node that hangs, and
# after get_param_names never answers anybody again.
_LOOKUPS_OF_DRIVERS = """
    get_param get_param_names has_param search_param service_host service_node service_type
    services_for_type topics_and_raw_types
"""
ROSAPI_LOOKUPS = frozenset(f"/rosapi/{name}" for name in _LOOKUPS.split())
ROSAPI_LOOKUPS_OF_DRIVERS = ROSAPI_LOOKUPS.union(
    f"/rosapi/{name}" for name in _LOOKUPS_OF_DRIVERS.split()
)

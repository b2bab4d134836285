"""Checks every message from a client against the list of operations, and writes it again for the robot.

An operation that is not in `operations`, or a field that its entry does not name, never reaches a robot: rosbridge, for
example, accepts `message_intervall` in any message, and would delay everything that it sends by it. A robot's settings
say which names each level may use.

Each connection has a `MessageValidator`; `bridge` asks it for every message and sends only what it returns. So what is
checked is what is sent: the client's own bytes must never pass, since the robot could read another operation in them
than this parser did.

A refusal is a sentence for the client, in rosbridge's own `status` operation; the connection stays open. Messages from
the robot never come here.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, Literal, NamedTuple

from robotether_common.guard import STAMP, count_values
from robotether_common.ros import Globs

from robotether_server.contract.ros import POLICY_REFUSES
from robotether_server.problems import RobotetherError
from robotether_server.relay.channels.rosbridge.drive_path import DriveCommand, DriveStamp
from robotether_server.relay.channels.rosbridge.operations import (
    OPERATIONS,
    ROSAPI_LOOKUPS,
    ROSAPI_LOOKUPS_OF_DRIVERS,
    FieldRefusedError,
    NotJsonError,
    Operation,
    Right,
    identity,
    read_json,
    scalars,
    speeds,
    write_json,
)
from robotether_server.relay.http.timing import Excess, RateLimiter
from robotether_server.settings.robot import LevelPolicy, Limits

Kind = Literal["topic", "service", "operation", "shape", "rate", "size", "subscriptions", "json"]

ANSWERS_PER_S = 10
# Maximum number of names whose right is cached; clients use few.
KNOWN_NAMES = 256
KB = 1024
# Number of values, like 1 KB of text, that take as long to read as a small message.
VALUES_AS_ONE = 64
# Divisor of the rate for observers, who send little and may be many.
OBSERVERS_SHARE = 10
# Time for which a client must exceed its rate by 100 % to count as flooding. Refusals cost time,
# too.
FLOOD_AFTER_S = 3.0
MIN_FLOOD_PER_S = 100
# A stop passes whatever else its sender floods the relay with. It is short, and its name spelt out.
STOP, MAX_STOP_BYTES = "robotether.stop", 256
STOP_WORD = f'"{STOP}"'.encode()
TOO_MANY = "cannot pass message: there are too many of them; send less often"
# Number of action_msgs/GoalStatus for a goal that no action server has taken.
STATUS_UNKNOWN = 0
# The service of an action in ROS 2 with which roslibjs cancels all goals: who may send them may do that.
CANCEL_GOAL = "/_action/cancel_goal"
HIDING = frozenset(("fragment", "png"))
# Refused before they count against what may be sent; all other refusals do.
TOO_MUCH: Collection[Kind] = ("rate", "size")


class MessageRefusedError(RobotetherError):
    """The message may not go to the robot.

    `answer` is what tells the client, None when it had enough of them this second; `floods` says that it was refused
    for its amount too often, and the connection should end.
    """

    answer: bytes | None = None
    floods = False

    def __init__(self, kind: Kind, why: str, message: Mapping[str, Any] | None = None) -> None:
        super().__init__(why)
        self.kind: Kind = kind
        self.message = message or {}


class ValidatedMessage(NamedTuple):
    """A message that passed. `data` goes to the robot, as a text message; it is published to `topic`, if any.

    With `drive`, what `stamped` makes of it goes in its place. With `own`, the operation is for
    the relay, `data` is empty, and `own` has its fields. With `subscription`, the topic goes its own way,
    and may be shared with others; `requested` has all that the client now requests of it, the oldest first. The
    `names` of each are those of `TopicRequest`.
    """

    data: bytes
    operation: str
    drive: DriveCommand | None = None
    own: Mapping[str, Any] | None = None
    subscription: Mapping[str, Any] | None = None
    topic: str | None = None
    requested: Sequence[Mapping[str, Any]] = ()


class MessageValidator:
    """Checks the messages of one connection."""

    def __init__(
        self,
        policy: LevelPolicy,
        drive_topics: Globs,
        limits: Limits,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        now = clock()
        self._clock = clock
        self._drives = policy.drives
        self._max_bytes = limits.message_kb * KB
        self._subscriptions = Subscriptions(limits.subscriptions)
        per_s = limits.messages_per_s / (1 if policy.drives else OBSERVERS_SHARE)
        # The largest text must fit in what may come at once.
        self._at_once = max(int(per_s), limits.message_kb + 1)
        self._messages = RateLimiter(now, per_s=per_s, at_once=self._at_once)
        self._answers = RateLimiter(now, per_s=ANSWERS_PER_S, at_once=ANSWERS_PER_S)
        self._refused = Excess(now, per_s=max(per_s, MIN_FLOOD_PER_S), for_s=FLOOD_AFTER_S)
        self._is_drive_topic = lru_cache(KNOWN_NAMES)(drive_topics.match)
        self._allowed: Mapping[Right, Callable[[str], bool]] = {
            "subscribe": lru_cache(KNOWN_NAMES)(policy.subscribe.match),
            "publish": lru_cache(KNOWN_NAMES)(policy.publish.match),
            "call": lru_cache(KNOWN_NAMES)(policy.call.match),
            "serve": lru_cache(KNOWN_NAMES)(policy.serve.match),
        }

    def check(self, data: bytes) -> ValidatedMessage:
        """Return what may go on in place of the message; raise MessageRefusedError when nothing may."""
        try:
            return self._check(data)
        except MessageRefusedError as refused:
            now = self._clock()
            if self._answers.allow(now):
                refused.answer = refusal(refused.detail, refused.message)
            if refused.kind in TOO_MUCH:
                refused.floods = self._refused.add(now, 1 + len(data) // KB)
            raise

    def _check(self, data: bytes) -> ValidatedMessage:
        passes = self._check_amount(data)
        message = _read(data)
        operation = message.get("op")
        if not passes and operation != STOP:
            raise MessageRefusedError("rate", TOO_MANY)
        entry = OPERATIONS.get(operation) if isinstance(operation, str) else None
        if entry is None or not isinstance(operation, str):
            raise MessageRefusedError("operation", _unknown(operation), message)
        fields = _fields_of(operation, entry, message)
        if entry.own:
            return ValidatedMessage(b"", operation, own=fields)
        self._check_right(entry, fields)
        if operation == "publish":
            return self._publish(fields)
        if entry.right == "subscribe":
            return self._subscribe(fields, message["topic"])
        return ValidatedMessage(write_json(fields), operation)

    def _check_amount(self, data: bytes) -> bool:
        """Return whether the message may pass whatever it is; if not, it still may be a stop."""
        size = len(data)
        if size > self._max_bytes:
            limit = self._max_bytes // KB
            raise MessageRefusedError(
                "size", f"cannot pass message: it has over {limit} KB, the robot's limit"
            )
        cost = message_cost(data)
        if cost > self._at_once:
            raise MessageRefusedError(
                "size", "cannot pass message: it has too many values for one message"
            )
        if self._messages.allow(self._clock(), cost):
            return True
        if not _may_be_stop(data):
            raise MessageRefusedError("rate", TOO_MANY)
        return False

    def _check_right(self, entry: Operation, fields: Mapping[str, Any]) -> None:
        if entry.right is None or entry.named_by is None:
            return
        name = fields[entry.named_by]
        if not (self._allowed[entry.right](name) or self._always(entry, fields, name)):
            kind: Kind = "topic" if entry.named_by == "topic" else "service"
            why = f"cannot {entry.says} {name}: {self._missing_right(entry.right)}"
            raise MessageRefusedError(kind, why, fields)

    def _always(self, entry: Operation, fields: Mapping[str, Any], name: str) -> bool:
        """Whether it passes without a glob: a driver's drive topics, everybody's look-ups, the cancel of goals."""
        if entry.right == "publish":
            return self._drives and self._is_drive_topic(name)
        look_ups = ROSAPI_LOOKUPS_OF_DRIVERS if self._drives else ROSAPI_LOOKUPS
        if fields["op"] == "call_service" and name in look_ups:
            _check_plain_values(fields)
            return True
        return fields["op"] == "call_service" and self._may_cancel(name)

    def _may_cancel(self, service: str) -> bool:
        action = service.removesuffix(CANCEL_GOAL)
        return action != service and self._allowed["call"](action)

    def _missing_right(self, right: Right) -> str:
        if right != "subscribe" and not self._drives:
            return (
                "an observing connection only subscribes and calls rosapi's look-ups of the graph"
            )
        return f"{POLICY_REFUSES}; an admin changes it on the robot's page"

    def _subscribe(self, fields: dict[str, Any], name: str) -> ValidatedMessage:
        topic = fields["topic"]
        subscription = {**fields, "names": (name,)}
        if not self._subscriptions.change(subscription):
            max_count = len(self._subscriptions)
            why = f"cannot subscribe to {topic}: this connection has {max_count} subscriptions, the robot's limit"
            raise MessageRefusedError("subscriptions", why, fields)
        requested = self._subscriptions.of(topic)
        return ValidatedMessage(
            write_json(fields), fields["op"], subscription=subscription, requested=requested
        )

    def _publish(self, fields: dict[str, Any]) -> ValidatedMessage:
        stamp = fields.pop(STAMP, None) or DriveStamp()
        topic = fields["topic"]
        if not self._is_drive_topic(topic):
            return ValidatedMessage(write_json(fields), "publish", topic=topic)
        try:
            speed, turn = speeds(fields.get("msg", {}))
        except FieldRefusedError as exc:
            raise MessageRefusedError(
                "shape", f"cannot publish to {topic}: msg {exc}", fields
            ) from exc
        data = write_json(fields)
        command = DriveCommand(topic, fields, data, stamp, speed, turn)
        return ValidatedMessage(data, "publish", command)


def read_stop(data: bytes) -> dict[str, Any] | None:
    """Return the fields of the operation with which a client stops the robot; None: the message is another."""
    if not _may_be_stop(data):
        return None
    try:
        message = read_json(data)
    except NotJsonError:
        return None
    return _fields_of(STOP, OPERATIONS[STOP], message) if message.get("op") == STOP else None


def status_error(text: str, message_id: object) -> bytes:
    """Build rosbridge's status message; `message_id` is the id of the message it answers."""
    return _answer(message_id, {"op": "status", "level": "error", "msg": text})


def refusal(why: str, message: Mapping[str, Any]) -> bytes:
    """Build the answer to a refused message: as rosbridge's to a call or goal that failed, else its status.

    Who calls waits for an answer of its kind, roslibjs and roslibpy for nothing else.
    """
    operation, message_id = message.get("op"), message.get("id")
    members: dict[str, object]
    if operation == "call_service":
        members = {"op": "service_response", "service": message.get("service")}
    elif operation == "send_action_goal":
        members = {"op": "action_result", "action": message.get("action"), "status": STATUS_UNKNOWN}
    else:
        return status_error(why, message_id)
    return _answer(message_id, members | {"values": why, "result": False})


def _answer(message_id: object, members: Mapping[str, object]) -> bytes:
    answer = dict(members)
    with suppress(FieldRefusedError):
        answer["id"] = identity(message_id)
    return json.dumps(answer).encode()


def _read(data: bytes) -> dict[str, Any]:
    try:
        return read_json(data)
    except NotJsonError as exc:
        raise MessageRefusedError("json", f"cannot read message: not JSON: {exc}") from exc


def _fields_of(operation: str, entry: Operation, message: Mapping[str, Any]) -> dict[str, Any]:
    """Return the message's known fields, checked; a field that is null counts as absent."""
    fields: dict[str, Any] = {"op": operation}
    for name, check in entry.checks:
        value = message.get(name)
        if value is None and name != entry.named_by:
            continue
        try:
            fields[name] = check(value)
        except FieldRefusedError as exc:
            why = f"cannot pass {operation}: its field {name} {exc}"
            raise MessageRefusedError("shape", why, message) from exc
    return fields


def _check_plain_values(fields: Mapping[str, Any]) -> None:
    """Look-ups take plain values; so an observer sends no object inside another."""
    try:
        scalars(fields.get("args", {}))
    except FieldRefusedError as exc:
        why = f"cannot pass call_service: its field args {exc}"
        raise MessageRefusedError("shape", why, fields) from exc


def message_cost(data: bytes) -> int:
    """Return for how many small messages one counts, by the time that reading it takes."""
    if len(data) < KB:
        return 1
    return 1 + len(data) // KB + count_values(data) // VALUES_AS_ONE


def _may_be_stop(data: bytes) -> bool:
    return len(data) <= MAX_STOP_BYTES and STOP_WORD in data


def _unknown(operation: object) -> str:
    if not isinstance(operation, str):
        return "cannot pass a message without op: it does not say what to do"
    if operation in HIDING:
        return f"cannot pass {operation}: its content cannot be checked; send messages whole"
    return f"cannot pass {operation[:64]}: the relay knows no such operation"


class Subscriptions:
    """What one connection has subscribed to, by topic, and by the client's name and id for it, as rosbridge counts it.

    At most `max_count`; a topic may be subscribed several times, each under an id of its own.
    """

    def __init__(self, max_count: int) -> None:
        self._max_count = max_count
        self._by_topic: dict[str, dict[tuple[object, object], Mapping[str, Any]]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._by_topic.values()))

    def of(self, topic: str) -> Sequence[Mapping[str, Any]]:
        """Return the subscriptions of a topic, the oldest first."""
        return tuple(self._by_topic.get(topic, {}).values())

    def change(self, message: Mapping[str, Any]) -> bool:
        """Do as a checked `subscribe` or `unsubscribe` says, an `unsubscribe` without an id for all of the name.

        An old subscription again counts once. False: there are too many.
        """
        topic, names, message_id = message["topic"], message.get("names"), message.get("id")
        requested = self._by_topic.get(topic, {})
        if message["op"] == "subscribe":
            if (names, message_id) not in requested and len(self) >= self._max_count:
                return False
            self._by_topic[topic] = {**requested, (names, message_id): message}
            return True
        left = {
            key: each
            for key, each in requested.items()
            if key[0] != names or message_id not in {None, key[1]}
        }
        self._by_topic[topic] = left
        if not left:
            del self._by_topic[topic]
        return True

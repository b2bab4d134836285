"""Lists the operations that a connection may send to a robot, with their fields.

`message_validator` checks every message from a client against this list. An operation that is not in it,
or a field that its entry does not name, never reaches a robot: rosbridge takes `message_intervall`
from any message, and would wait so long before everything that it sends. docs/reference/protocols.md has
the same table for people. Data only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from robotether_server.relay.rosbridge import fields
from robotether_server.relay.rosbridge.fields import Check

# Whose globs of the level's policy the operation's name must match.
Right = Literal["subscribe", "publish", "call", "serve"]

LEVELS = ("info", "warning", "error", "none")
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
MAX_THROTTLE_MS = 3_600_000
MAX_QUEUE = 1000
MAX_CALL_S = 60.0
# Smaller pieces would make the robot write many messages of one.
FRAGMENT_BYTES = (4096, 2**31 - 1)
STATUS_CODES = (-128, 127)


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
    "fragment_size": fields.whole(*FRAGMENT_BYTES),
    "compression": fields.choice(*COMPRESSIONS),
}
_TOPIC: Mapping[str, Check] = {
    "id": fields.identity,
    "topic": fields.ros_name,
    "type": fields.text,
}
_PUBLISHED: Mapping[str, Check] = {
    "latch": fields.flag,
    "queue_size": fields.whole(0, MAX_QUEUE),
    "qos": fields.scalars,
}
_GOAL: Mapping[str, Check] = {
    "id": fields.identity,
    "action": fields.ros_name,
    "action_type": fields.text,
    "args": fields.payload,
    "feedback": fields.flag,
    **_ANSWER,
}
_SERVICE: Mapping[str, Check] = {
    "id": fields.identity,
    "service": fields.ros_name,
    "type": fields.text,
    "values": fields.payload,
    "result": fields.flag,
}
_ACTION: Mapping[str, Check] = {
    "id": fields.identity,
    "action": fields.ros_name,
    "type": fields.text,
    "values": fields.payload,
    "status": fields.whole(*STATUS_CODES),
    "result": fields.flag,
}
_STATUS: Mapping[str, Check] = {
    "id": fields.identity,
    "level": fields.choice(*LEVELS),
    "msg": fields.text,
}

OPERATIONS: Mapping[str, Operation] = {
    "subscribe": Operation(
        "subscribe to",
        {
            **_TOPIC,
            "throttle_rate": fields.whole(0, MAX_THROTTLE_MS),
            "queue_length": fields.whole(0, MAX_QUEUE),
            "qos": fields.scalars,
            **_ANSWER,
        },
        "subscribe",
        "topic",
    ),
    "unsubscribe": Operation(
        "unsubscribe from",
        {"id": fields.identity, "topic": fields.ros_name},
        "subscribe",
        "topic",
    ),
    "advertise": Operation("advertise", {**_TOPIC, **_PUBLISHED}, "publish", "topic"),
    "unadvertise": Operation("unadvertise", {**_TOPIC, **_PUBLISHED}, "publish", "topic"),
    "publish": Operation(
        "publish to",
        {**_TOPIC, "msg": fields.members, **_PUBLISHED, "robotether": fields.stamp},
        "publish",
        "topic",
    ),
    "call_service": Operation(
        "call",
        {
            "id": fields.identity,
            "service": fields.ros_name,
            "type": fields.text,
            "args": fields.payload,
            "timeout": fields.number(0, MAX_CALL_S),
            **_ANSWER,
        },
        "call",
        "service",
    ),
    "send_action_goal": Operation("send a goal to", _GOAL, "call", "action"),
    "cancel_action_goal": Operation("cancel a goal of", _GOAL, "call", "action"),
    "advertise_service": Operation("serve", _SERVICE, "serve", "service"),
    "unadvertise_service": Operation("stop serving", _SERVICE, "serve", "service"),
    "service_response": Operation("answer for", _SERVICE, "serve", "service"),
    "advertise_action": Operation("serve", _ACTION, "serve", "action"),
    "unadvertise_action": Operation("stop serving", _ACTION, "serve", "action"),
    "action_feedback": Operation("answer for", _ACTION, "serve", "action"),
    "action_result": Operation("answer for", _ACTION, "serve", "action"),
    "action_status": Operation("answer for", _ACTION, "serve", "action"),
    "status": Operation("send a status", _STATUS),
    "set_level": Operation("set the level", _STATUS),
    "robotether.beat": Operation(
        "answer the beat", {"t_ms": fields.timestamp, "key": fields.text}, own=True
    ),
    "robotether.stop": Operation("stop the robot", {}, own=True),
}

# Services of rosapi that only look something up; every level may call them.
ROSAPI_LOOKUPS = frozenset(
    f"/rosapi/{name}"
    for name in (
        "action_feedback_details",
        "action_goal_details",
        "action_result_details",
        "action_servers",
        "action_type",
        "get_param",
        "get_param_names",
        "get_ros_version",
        "get_time",
        "has_param",
        "interfaces",
        "message_details",
        "node_details",
        "nodes",
        "publishers",
        "search_param",
        "service_host",
        "service_node",
        "service_providers",
        "service_request_details",
        "service_response_details",
        "service_type",
        "services",
        "services_for_type",
        "subscribers",
        "topic_type",
        "topics",
        "topics_and_raw_types",
        "topics_for_type",
    )
)

"""A message validator for tests, and examples of what each level may send through it."""

from __future__ import annotations

import json

import pytest
from robotether_server.relay.channels.rosbridge.message_validator import (
    MessageRefusedError,
    MessageValidator,
    ValidatedMessage,
)
from robotether_server.schemas import Level
from robotether_server.settings.robot import parse

# Messages that an observer may send, each with all that it may hold.
OBSERVING = [
    {"op": "subscribe", "topic": "/pose"},
    {
        "op": "subscribe",
        "id": "subscribe:/pose:1",
        "topic": "/pose",
        "type": "turtlesim/Pose",
        "throttle_rate": 100,
        "queue_length": 1,
        "qos": {"history": "keep_last", "depth": 1},
        "fragment_size": 100_000,
        "compression": "cbor",
    },
    {"op": "unsubscribe", "id": 7, "topic": "/pose"},
    {
        "op": "call_service",
        "id": "call_service:/rosapi/topic_type:2",
        "service": "/rosapi/topic_type",
        "args": {"topic": "/pose"},
        "timeout": -1.0,
        "compression": "none",
    },
    {"op": "call_service", "service": "/rosapi/topics", "args": []},
    {"op": "status", "id": "x", "level": "error", "msg": "what"},
    {"op": "set_level", "level": "warning"},
]
DRIVING = [
    {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist", "queue_size": 1},
    {
        "op": "publish",
        "id": "p1",
        "topic": "/a/cmd_vel",
        "msg": {"linear": {"x": 0.5}},
        "latch": False,
    },
    {"op": "unadvertise", "topic": "/cmd_vel"},
]
MANAGING = [
    {"op": "publish", "topic": "/chatter", "type": "std_msgs/String", "msg": {"data": "ü", "op": "publish"}},
    {"op": "call_service", "service": "/reset", "args": {"deep": [{"x": [1, 2.5, None, True]}]}},
    {"op": "send_action_goal", "id": "g", "action": "/go", "action_type": "a/Go", "args": {"x": 1}, "feedback": True},
    {"op": "cancel_action_goal", "id": "g", "action": "/go"},
    {"op": "advertise_service", "service": "/mine", "type": "std_srvs/Empty"},
    {"op": "service_response", "id": "s", "service": "/mine", "values": {"a": []}, "result": True},
    {"op": "service_response", "id": "s", "service": "/mine", "values": "Error: why", "result": False},
    {"op": "unadvertise_service", "service": "/mine"},
    {"op": "advertise_action", "action": "/act", "type": "a/Act"},
    {"op": "action_feedback", "id": "f", "action": "/act", "values": {"p": 1}},
    {"op": "action_status", "id": "f", "action": "/act", "status": 4},
    {"op": "action_result", "id": "f", "action": "/act", "values": {}, "status": 4, "result": True},
    {"op": "unadvertise_action", "action": "/act"},
]  # fmt: skip


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def validator(
    level: Level = "observe", settings: object = None, clock: Clock | None = None
) -> MessageValidator:
    known = parse(settings or {})
    policy = known.policy
    return MessageValidator(
        policy.of(level), known.guard.drive_topics, policy.limits, clock=clock or Clock()
    )


def check(message: object, at: MessageValidator) -> ValidatedMessage:
    data = message if isinstance(message, bytes) else json.dumps(message).encode()
    return at.check(data)


def sent(message: object, at: MessageValidator) -> object:
    return json.loads(check(message, at).data)


def refused(message: object, at: MessageValidator) -> tuple[str, dict[str, object]]:
    with pytest.raises(MessageRefusedError) as refusal:
        check(message, at)
    assert refusal.value.answer is not None
    return refusal.value.kind, json.loads(refusal.value.answer)


def name_of(message: dict[str, object]) -> str:
    return str(message["op"])

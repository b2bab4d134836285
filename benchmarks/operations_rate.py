"""How many operations one core of the relay checks, and what the dearest message costs. Used by `bench`."""

from __future__ import annotations

import gc
import json
from collections.abc import Mapping
from timeit import Timer

from report import Row, Section
from robotether_server.relay.channels.rosbridge.drive_path import stamped
from robotether_server.relay.channels.rosbridge.message_validator import MessageValidator
from robotether_server.settings.robot import DEFAULTS, Limits

# The check alone is measured, not how soon it says that there were too many.
UNLIMITED = Limits(messages_per_s=10**9, message_kb=DEFAULTS.policy.limits.message_kb)
REPEATS = 5
LARGEST_NUMBERS = 52_000
LARGEST_OBJECTS = 55_000
AIM_US = 15


def kinds() -> Mapping[str, bytes]:
    twist = {"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -0.2345678}}
    stamp = {"t_ms": 5123456.789}
    numbers = [number / 7 for number in range(LARGEST_NUMBERS)]
    plain = {
        "`publish` Twist to a drive topic": {
            "op": "publish", "topic": "/cmd_vel", "msg": twist, "robotether": stamp,
        },
        "`subscribe`": {
            "op": "subscribe", "id": "subscribe:/pose:1", "topic": "/pose", "type": "turtlesim/Pose",
            "throttle_rate": 100, "queue_length": 1, "compression": "none",
        },
        "`publish` of one text, 200 bytes": {
            "op": "publish", "topic": "/chatter", "msg": {"data": "x" * 142},
        },
        "`publish` of 500 numbers, 10 KB": {
            "op": "publish", "topic": "/scan", "msg": {"ranges": [number / 7 for number in range(560)]},
        },
        "`publish` of as many numbers as allowed": {
            "op": "publish", "topic": "/cloud", "msg": {"data": numbers},
        },
        "`publish` of as many objects as allowed": {
            "op": "publish", "topic": "/cloud", "msg": {"data": [{}] * LARGEST_OBJECTS},
        },
    }  # fmt: skip
    return {name: json.dumps(message).encode() for name, message in plain.items()}


def row_of(name: str, data: bytes) -> Row:
    validator = MessageValidator(DEFAULTS.policy.manage, DEFAULTS.guard.drive_topics, UNLIMITED)

    def check() -> None:
        command = validator.check(data).drive
        if command is not None:
            stamped(command, 1.5, 7)

    # With garbage collection, as in the relay.
    timer = Timer(check, gc.enable)
    count, _ = timer.autorange()
    us_each = min(timer.repeat(REPEATS, count)) / count * 1_000_000
    return {
        "message": name,
        "bytes": len(data),
        "us each": us_each,
        "a second on a core": 1_000_000 / us_each,
    }


def measure() -> Section:
    return Section(
        "Operations checked by the relay",
        f"The time to check and rewrite one message, on one core and connection, the fastest of {REPEATS} rounds. "
        "While the relay reads a large message, it does nothing else. By default a driver's connection may send about "
        f"one of the largest a second.\n\nAim: a small message under {AIM_US} us.",
        [row_of(name, data) for name, data in kinds().items()],
    )

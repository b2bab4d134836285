"""Fuzzes what the relay reads from clients: whatever bytes come, they are refused or written anew.

Run as `python tests/fuzz/fuzz_relay_messages.py -max_total_time=60`; `test_fuzz.py` does so for some seconds.
Nothing but MessageRefusedError may be raised; what passes must mean what another parser reads, and must pass again as
it is. Which names may pass, hypothesis tries in tests/unit.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from random import Random

import atheris

sys.path[:0] = [str(Path(__file__).resolve().parents[2] / name) for name in ("common", "server")]
with atheris.instrument_imports(include=["robotether_common", "robotether_server", "json"]):
    from robotether_common.ros import Globs
    from robotether_server.relay.channels.rosbridge.message_validator import (
        MessageRefusedError,
        MessageValidator,
    )
    from robotether_server.relay.channels.rosbridge.operations import OPERATIONS
    from robotether_server.settings.robot import LevelPolicy, Limits

SEEDS = (
    {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.5}}, "robotether": {"t_ms": 1.5}},
    {"op": "publish", "topic": "a", "msg": {"data": "ü", "n": [1, 2.5, -3e7, None, True]}},
    {"op": "subscribe", "id": "s", "topic": "/a", "type": "x/Y", "qos": {"depth": 1}, "throttle_rate": 9},
    {"op": "call_service", "service": "/rosapi/topics", "args": [], "timeout": 2},
    {"op": "robotether.clock_sync", "t_ms": 81.2},
)  # fmt: skip
WORDS = sorted({*OPERATIONS, *(name for entry in OPERATIONS.values() for name in entry.fields)})
NEW_MESSAGES = 0.1
ANSWERS = ("status", "service_response", "action_result")


def fuzz_one(data: bytes) -> None:
    """Check one message of somebody who may do all."""
    policy = LevelPolicy(*[Globs(["*"])] * 4, drives=True)
    validator = MessageValidator(policy, Globs(["/cmd_vel", "*/cmd_vel"]), Limits())
    try:
        checked = validator.check(data)
    except MessageRefusedError as refusal:
        if json.loads(refusal.answer or b'{"op": "status"}')["op"] not in ANSWERS:
            raise AssertionError(refusal.answer) from refusal
        return
    if checked.own is None:
        sent, meant = json.loads(checked.data), json.loads(data)
        assert sent.keys() <= {"op", *OPERATIONS[checked.operation].fields} - {"robotether"}
        for name in {"op", "msg", "args", "values"} & sent.keys():
            assert sent[name] == meant[name]
        assert validator.check(checked.data).data == checked.data


def seed_of(random: Random) -> bytes:
    """One of the messages to begin with, sometimes with another operation or a word elsewhere."""
    message = dict(random.choice(SEEDS))
    if random.random() < 0.7:
        message[random.choice(["op", *WORDS])] = random.choice(WORDS)
    return json.dumps(message).encode()


def mutate(data: bytes, max_size: int, seed: int) -> bytes:
    """Change bytes, and begin anew with a message once in a while."""
    random = Random(seed)
    if not data or random.random() < NEW_MESSAGES:
        data = seed_of(random)
    return bytes(atheris.Mutate(data, max_size))[:max_size]


def main() -> None:
    atheris.Setup(sys.argv, fuzz_one, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main()

"""Fuzzes what the relay reads from clients: whatever bytes come, they are refused or written anew.

Run as `python tests/fuzz/fuzz_relay_messages.py -max_total_time=60`; `test_fuzz.py` does so for some
seconds. Nothing but MessageRefusedError may be raised; what passes must be one JSON object of an
operation in the list, with a full name that the policy allows, and must pass again as it is.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from random import Random

import atheris

sys.path[:0] = [str(Path(__file__).resolve().parents[2] / name) for name in ("common", "server")]
with atheris.instrument_imports(include=["robotether_common", "robotether_server", "json"]):
    from robotether_common.ros import Globs
    from robotether_server.relay.channels.rosbridge.drive_path import stamped
    from robotether_server.relay.channels.rosbridge.message_validator import (
        MessageRefusedError,
        MessageValidator,
        ValidatedMessage,
    )
    from robotether_server.relay.channels.rosbridge.operations import (
        OPERATIONS,
        ROSAPI_LOOKUPS_OF_DRIVERS,
    )
    from robotether_server.settings.robot import LevelPolicy, Limits

DRIVE_TOPICS = Globs(["/cmd_vel", "*/cmd_vel"])
FULL_NAME = re.compile(r"(/[A-Za-z0-9_]+)+")
POLICIES = (
    LevelPolicy(subscribe=Globs(["/a*"])),
    LevelPolicy(subscribe=Globs(["*"]), publish=Globs(["/a"]), call=Globs(["/a/*"]), drives=True),
    LevelPolicy(*[Globs(["*"])] * 4, drives=True),
)
SEEDS = (
    {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.5}}, "robotether": {"t_ms": 1.5}},
    {"op": "publish", "topic": "a", "msg": {"data": "ü", "n": [1, 2.5, -3e7, None, True]}},
    {"op": "subscribe", "id": "s", "topic": "/a", "type": "x/Y", "qos": {"depth": 1}, "throttle_rate": 9},
    {"op": "call_service", "service": "/rosapi/topics", "args": [], "timeout": 2},
    {"op": "robotether.clock_sync", "t_ms": 81.2},
)  # fmt: skip
WORDS = sorted({*OPERATIONS, *(name for entry in OPERATIONS.values() for name in entry.fields)})
PAYLOADS = {"msg", "args", "values"}
NEW_MESSAGES = 0.1


def names_are_allowed(
    policy: LevelPolicy, checked: ValidatedMessage, sent: dict[str, object]
) -> bool:
    """Whether the operation's name is a full one that the policy lets pass."""
    entry = OPERATIONS[checked.operation]
    if entry.named_by is None or entry.right is None:
        return True
    name = str(sent[entry.named_by])
    return FULL_NAME.fullmatch(name) is not None and (
        getattr(policy, entry.right).match(name)
        or (entry.right == "publish" and policy.drives and DRIVE_TOPICS.match(name))
        or (checked.operation == "call_service" and name in ROSAPI_LOOKUPS_OF_DRIVERS)
    )


def look_at_passed(
    policy: LevelPolicy, validator: MessageValidator, data: bytes, checked: ValidatedMessage
) -> None:
    """Fail unless what passed is what may pass, and means what another parser reads."""
    entry = OPERATIONS[checked.operation]
    if entry.own:
        assert checked.data == b""
        assert checked.own is not None
        return
    sent = json.loads(checked.data.decode())
    assert sent["op"] == checked.operation
    assert sent.keys() <= {"op", *entry.fields} - {"robotether"}
    assert names_are_allowed(policy, checked, sent)
    given = json.loads(data.decode())
    for name in PAYLOADS & entry.fields.keys():
        assert sent.get(name) == given.get(name)
    assert validator.check(checked.data).data == checked.data
    if checked.drive is not None:
        assert json.loads(stamped(checked.drive, 1.0, 2)).pop("robotether") == {
            "t_ms": 1.0,
            "fence": 2,
        }


def check(validator: MessageValidator, data: bytes) -> ValidatedMessage | None:
    """Return what passed; None for a message that was refused as it should be."""
    try:
        return validator.check(data)
    except MessageRefusedError as refusal:
        answer = refusal.answer or b"{}"
    if json.loads(answer).get("op") != "status":
        raise AssertionError(f"an answer is not a status message: {answer!r}")
    return None


def fuzz_one(data: bytes) -> None:
    """Check one message; the first byte chooses the level."""
    policy = POLICIES[data[0] % len(POLICIES)] if data else POLICIES[0]
    validator = MessageValidator(policy, DRIVE_TOPICS, Limits())
    checked = check(validator, data[1:])
    if checked is not None:
        look_at_passed(policy, validator, data[1:], checked)


def seed_of(number: int) -> bytes:
    """One of the messages to begin with, sometimes with another operation or a word elsewhere."""
    number, level = divmod(number, len(POLICIES))
    number, place = divmod(number, len(SEEDS))
    number, word = divmod(number, len(WORDS))
    message = dict(SEEDS[place])
    if number % 3 == 0:
        message["op"] = WORDS[word]
    elif number % 3 == 1:
        message[WORDS[word]] = WORDS[number % len(WORDS)]
    return bytes([level]) + json.dumps(message).encode()


def mutate(data: bytes, max_size: int, seed: int) -> bytes:
    """Change bytes, and begin anew with a message once in a while."""
    random = Random(seed)
    if not data or random.random() < NEW_MESSAGES:
        data = seed_of(random.getrandbits(32))
    return bytes(atheris.Mutate(data, max_size))[:max_size]


def main() -> None:
    atheris.Setup(sys.argv, fuzz_one, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main()

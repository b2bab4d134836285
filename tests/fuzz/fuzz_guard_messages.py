"""Fuzzes the guard's parser: whatever an operator sends, nothing that can drive passes, and nothing else is raised.

Run by `pytest tests/fuzz` for some seconds, or by hand without end: `python tests/fuzz/fuzz_guard_messages.py`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import atheris

sys.path[:0] = [str(Path(__file__).resolve().parents[2] / name) for name in ("common", "agent")]

with atheris.instrument_imports(include=["robotether_common", "robotether_agent.guard"]):
    from robotether_agent.guard import drive_messages
    from robotether_agent.guard.drive_messages import DriveMessageRefusedError, DriveTopics

TOPICS = DriveTopics(["/cmd_vel", "*/cmd_vel", "/base/vel*"])
SEEDS = (
    b'{"op":"publish","topic":"/cmd_vel","msg":{"linear":{"x":1},"angular":{"z":-0.5}},"id":"a"}',
    b'{"op":"publish","topic":"base/cmd_vel","msg":{"header":{"stamp":{"sec":1}},"twist":{}}}',
    b'{"op":"advertise","topic":"/cmd_vel","type":"geometry_msgs/Twist"}',
    b'{"op":"subscribe","topic":"/odom","msg":{"op":"publish","topic":"/cmd_vel"}}',
    b'{"op":"fragment","data":"{}","id":1}',
)


def one_input(data: bytes) -> None:
    """Check one message as the client proxy and the drive controller do."""
    try:
        found = drive_messages.drive_message(data, TOPICS)
    except drive_messages.DriveMessageUnclearError:
        return
    if found is None:
        must_not_drive(json.loads(data))
    elif found.operation == "publish":
        must_be_sound(found)


def must_not_drive(message: Any) -> None:
    """An independent look at what would pass: no guarded operation inside, and none on a drive topic."""
    assert isinstance(message, dict)
    inside = [op for value in message.values() for op in operations(value)]
    assert not drive_messages.GUARDED.intersection(op for op in inside if isinstance(op, str))
    assert message["op"] not in drive_messages.WRAPPERS
    if message["op"] in drive_messages.ON_TOPICS:
        assert not TOPICS.match("/" + message["topic"].strip("/"))
        assert drive_messages.STAMP not in message


def must_be_sound(found: drive_messages.DriveMessage) -> None:
    """What a command says anew is JSON, and says the same when it is read again."""
    try:
        command = drive_messages.read_command(found.fields.get("msg", {}), None)
    except DriveMessageRefusedError:
        return
    again = json.loads(json.dumps(drive_messages.write_command(command), allow_nan=False))
    assert drive_messages.read_command(again, None).linear == command.linear


def operations(value: Any) -> list[Any]:
    """Every `op` inside, without recursion: messages may be deep."""
    found, open_values = [], [value]
    while open_values:
        item = open_values.pop()
        if isinstance(item, dict):
            found += [item["op"]] if "op" in item else []
            open_values += item.values()
        elif isinstance(item, list):
            open_values += item
    return found


if __name__ == "__main__":
    for seed in SEEDS:
        one_input(seed)
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()

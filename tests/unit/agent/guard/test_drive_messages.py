"""The guard's parser of what comes from operators."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.drive_messages import (
    GUARDED,
    DriveMessage,
    DriveTopics,
    Unclear,
    drive_message,
    message_id,
)
from robotether_common.ros import MAX_GLOB_LENGTH, full_name

DEFAULT = DriveTopics(["/cmd_vel", "*/cmd_vel"])
TOPICS = DriveTopics(["/cmd_vel", "*/cmd_vel"])


@pytest.mark.parametrize(
    ("name", "drives"),
    [("/cmd_vel", True), ("/a/cmd_vel", True), ("/a/b/cmd_vel", True), ("/cmd_vel2", False), ("/my_cmd_vel", False)],
)  # fmt: skip
def test_a_star_stands_for_any_text(name: str, *, drives: bool) -> None:
    """Slashes included, and the whole name counts."""
    assert DEFAULT.match(name) is drives


def test_a_relative_name_may_be_a_drive_topic_in_a_namespace() -> None:
    """Rosbridge in the namespace /base makes /base/vel of vel."""
    topics = DriveTopics(["/base/vel"])
    assert not topics.match("/vel")
    assert topics.might_be("vel")
    assert not topics.might_be("scan")


def test_patterns_are_names_with_stars() -> None:
    """What else stands in them could match no name."""
    for wrong in ("/cmd[v]el", "/cmd?vel", "", "/cmd vel"):
        with pytest.raises(ValueError, match="no name"):
            DriveTopics([wrong])
    with pytest.raises(ValueError, match="no name"):
        DriveTopics(["/" * (MAX_GLOB_LENGTH + 1)])
    # The server takes as many; a robot that refused one would never connect.
    assert DriveTopics(["*" * MAX_GLOB_LENGTH]).match("/cmd_vel")
    assert DEFAULT.plain() == ["/cmd_vel"]
    assert not DriveTopics([]).match("/cmd_vel")


def test_many_stars_take_no_long_time() -> None:
    """A pattern from the settings must not hold the guard up."""
    topics = DriveTopics(["*a" * 100 + "b"])
    begun = time.process_time()
    assert not topics.match("/" + "a" * 250)
    assert time.process_time() - begun < 0.5


@given(st.from_regex(r"(/[a-z_]{1,8}){0,3}/cmd_vel", fullmatch=True))
def test_every_cmd_vel_drives(name: str) -> None:
    """In whatever namespace the robot's base listens."""
    assert DEFAULT.match(name)
    assert full_name(name) == name


def read(data: bytes | dict[str, Any]) -> DriveMessage | None:
    return drive_message(data if isinstance(data, bytes) else json.dumps(data).encode(), TOPICS)


@pytest.mark.parametrize(
    "message",
    [
        {"op": "subscribe", "topic": "/cmd_vel"},
        {"op": "publish", "topic": "/chatter", "msg": {"data": "x"}},
        {"op": "call_service", "service": "/x", "args": {"op": "open"}},
        {"op": "set_level", "level": "none"},
        {"op": "subscribe", "topic": "~odd"},
        {"op": "a new operation"},
    ],
)
def test_what_does_not_drive_may_pass(message: dict[str, Any]) -> None:
    """Rosbridge knows best what the rest means."""
    assert read(message) is None


@pytest.mark.parametrize("operation", ["publish", "advertise", "unadvertise"])
@pytest.mark.parametrize("name", ["/cmd_vel", "cmd_vel", "/base/cmd_vel", "base/cmd_vel"])
def test_operations_on_drive_topics_are_found(operation: str, name: str) -> None:
    """In either spelling of the name, which is given back with its slash."""
    message = read({"op": operation, "topic": name, "msg": {}})
    assert message is not None
    assert (message.operation, message.topic) == (operation, "/" + name.lstrip("/"))


@pytest.mark.parametrize("operation", ["publish", "advertise", "unadvertise"])
def test_a_drive_command_for_what_is_no_drive_topic_here_is_refused(operation: str) -> None:
    """Settings change at the server first: what it stamped must not reach the wheels past the guard."""
    with pytest.raises(Unclear, match="is a drive topic for the server"):
        read({"op": operation, "topic": "/base/move", "robotether": {"t_ms": 1.0, "fence": 13}})


def test_escapes_hide_no_operation() -> None:
    """JSON may spell any letter as a number."""
    found = read(rb'{"\u006fp":"\u0070ublish","topic":"/cmd\u005fvel","msg":{}}')
    assert found is not None
    assert found.topic == "/cmd_vel"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"null",
        b"[]",
        b"{}",
        b'{"op":3}',
        b'{"op":"publish","topic":"/cmd_vel"',
        b'{"op":"publish","topic":"/cmd_vel","msg":{}}}',
        b'{"op":"publish","op":"subscribe","topic":"/cmd_vel"}',
        b'{"op":"publish","topic":"/cmd_vel","topic":"/x"}',
        b'{"op":"subscribe","topic":"/x","a":{"op":"publish","topic":"/cmd_vel"}}',
        b'{"op":"publish","topic":"/x","msg":{"op":"publish","topic":"/cmd_vel"}}',
        b'{"op":"call_service","args":[NaN,{"op":"x"}]}',
        b'{"op":"publish","topic":"//cmd_vel"}',
        b'{"op":"publish","topic":"/x/../cmd_vel"}',
        b'{"op":"publish"}',
        b'{"op":"fragment","id":"1","data":"..."}',
        b'{"op":"png","data":"..."}',
        b"\xff{}",
        b"\xef\xbb\xbf{}",
        '{"op":"publish","topic":"/cmd_vel"}'.encode("utf-16"),
        b'{"op":"x","a":' + b"[" * 100_000,
        b'{"op":"x","a":' + b"1" * 5000 + b"}",
        b"\x15\x00\x00\x00\x02op\x00\x08\x00\x00\x00publish\x00\x00",
    ],
)  # fmt: skip
def test_what_cannot_be_checked_is_refused(data: bytes) -> None:
    """Whatever else rosbridge's parser could make of it."""
    with pytest.raises(Unclear):
        read(data)


def test_a_refusal_names_the_message() -> None:
    """The client finds its own id in the answer."""
    with pytest.raises(Unclear) as refused:
        read({"op": "png", "id": "p1"})
    assert (refused.value.message_id, refused.value.kind) == ("p1", "shape")


def test_an_id_is_a_short_text_or_a_number() -> None:
    """Nothing else goes back, and none goes on to rosbridge."""
    ids = ["a", 3, None, True, 1.5, {}, "x" * 1000]
    assert [message_id({"id": value}) for value in ids] == ["a", 3, None, None, None, None, None]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8) | st.sampled_from([*GUARDED, "/cmd_vel", "/x"]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["op", "topic", "msg", "id", "x"]), inner, max_size=5),
    max_leaves=12,
)  # fmt: skip


def operations(value: object) -> list[object]:
    """Every `op` anywhere in a value."""
    if isinstance(value, dict):
        return [value[k] for k in value if k == "op"] + [
            x for v in value.values() for x in operations(v)
        ]
    return [x for v in value for x in operations(v)] if isinstance(value, list) else []


@given(JSON)
def test_nothing_that_passes_can_drive(value: object) -> None:
    """Neither itself nor by an operation inside that a parser in trouble could find."""
    try:
        passed = read(json.dumps(value).encode()) is None
    except Unclear:
        return
    assert isinstance(value, dict)
    inner = operations(list(value.values()))
    assert not [op for op in inner if isinstance(op, str) and op in GUARDED]
    if passed and value["op"] in ("publish", "advertise", "unadvertise"):
        assert not TOPICS.match("/" + value["topic"].lstrip("/"))


@given(st.binary(max_size=200))
def test_rubbish_is_refused_and_raises_nothing_else(data: bytes) -> None:
    try:
        read(data)
    except Unclear:
        return

"""The lines of the session, and what is wrong with them."""

from __future__ import annotations

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.robots.session_messages import (
    BrokenLineError,
    Preface,
    WrongKeyError,
    bye_line,
    checked_line,
    config_line,
    parse_guard,
    parse_line,
    parse_preface,
    pong_line,
    printable_field,
)

PREFACE = {
    "type": "preface",
    "kind": "media",
    "robot_id": 7,
    "address": "198.51.100.7",
    "fingerprint": "SHA256:abc",
    "ports": [20000, 20001],
    "session_key": "the key",
}


def preface(**changes: object) -> bytes:
    return json.dumps(PREFACE | changes).encode()


def test_a_preface_is_read():
    """Kind, robot, address, key and ports come out of it."""
    assert parse_preface(preface(), "the key") == Preface(
        "media", 7, "198.51.100.7", "SHA256:abc", frozenset({20000, 20001})
    )


@pytest.mark.parametrize("kind", ["session", "media", "shell"])
def test_every_kind_is_read(kind):
    """The three connections of a robot."""
    assert parse_preface(preface(kind=kind), "the key").kind == kind


@pytest.mark.parametrize("key", ["", "the keY", None, 7, ["the key"], "schlüssel"])
def test_a_wrong_key_is_found_first(key):
    """Whatever else is wrong, a wrong key is what counts."""
    with pytest.raises(WrongKeyError):
        parse_preface(preface(session_key=key, kind=7, type="hello"), "the key")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("kind", "exec"),
        ("kind", None),
        ("kind", ["shell"]),
        ("fingerprint", None),
        ("fingerprint", "x" * 65),
        ("ports", None),
        ("ports", "20000"),
        ("ports", [20000, "20001"]),
        ("ports", [True]),
        ("robot_id", "7"),
        ("robot_id", True),
        ("robot_id", 7.5),
        ("address", "x" * 46),
        ("address", None),
    ],
)
def test_a_wrong_field_is_named(field, value):
    """The problem says which field it is."""
    with pytest.raises(BrokenLineError, match=field):
        parse_preface(preface(**{field: value}), "the key")


@pytest.mark.parametrize("count", [-1, 2**53, True, "7", 1.0])
def test_a_guard_counts_from_0(count):
    """A count that can be none ends up in no record and no sum."""
    line = {"state": "ready", "stopped": False, "by": "", "moving": False}
    assert parse_guard({**line, "refused": {"held": 7}})[0].refused == (("held", 7),)
    with pytest.raises(BrokenLineError, match="old"):
        parse_guard({**line, "refused": {"old": count}})


@pytest.mark.parametrize("text", ["1\ud800", "1\x1b[2J", "1\n", "1\u202e"])
def test_what_people_see_is_printable(text):
    """Half a character would spoil the write of a whole batch of records, others steer terminals."""
    assert printable_field({"agent_version": "0.1.0"}, "agent_version", 32) == "0.1.0"
    with pytest.raises(BrokenLineError, match="agent_version"):
        printable_field({"agent_version": text}, "agent_version", 32)


def test_a_pong_carries_the_agents_clock_back():
    """Number and time come back as they were."""
    assert json.loads(pong_line({"seq": 17, "t_ms": 123456.7})) == {
        "type": "pong",
        "seq": 17,
        "t_ms": 123456.7,
    }
    for ping in ({"seq": 17}, {"seq": 17, "t_ms": "now"}):
        with pytest.raises(BrokenLineError, match="t_ms"):
            pong_line(ping)


def test_lines_end_where_they_should():
    """Each line is one line, whatever a text in it holds."""
    robot = RelayRobot(7, "a\nb", "active", 1, 2)
    config = config_line(robot, heartbeat_s=1, timeout_s=5, guard_key="k", direct=False)
    checked = checked_line(ros="ok", video="down", shell="unknown")
    for line in (config, checked, bye_line("timeout", "x\ny")):
        assert line.count(b"\n") == 1
        assert line.endswith(b"\n")


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_a_named_problem(data):
    """Nothing but BrokenLineError comes out of rubbish."""
    with contextlib.suppress(BrokenLineError):
        assert isinstance(parse_line(data)["type"], str)

"""The lines of the session, and what is wrong with them."""

import json

import pytest
from robotether_common.guard import MAX_SLOWED_S
from robotether_common.session import MAX_HELP_REASON, Battery, HelpCall
from robotether_server.problems import ProtocolError
from robotether_server.relay.robots.robot import GuardReport
from robotether_server.relay.robots.session_messages import (
    WrongKeyError,
    parse_line,
    parse_preface,
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


@pytest.mark.parametrize("key", ["", "the keY", None, 7, ["the key"], "schlüssel"])
def test_a_wrong_key_is_found_first(key):
    with pytest.raises(WrongKeyError):
        parse(PREFACE, session_key=key, kind=7, type="hello")


GUARD = {"type": "guard", "state": "ready", "stopped": False, "by": "", "moving": False}
HELLO = {"type": "hello", "hostname": "turtle", "agent_version": "0.1.0", "guard": "on"}
HEALTH = {"type": "health", "ros": "ok", "video": "down", "ros_exposed": False}
PING = {"type": "ping", "seq": 17, "t_ms": 123456.7}


def parse(line, **changes):
    data = json.dumps(line | changes).encode()
    return parse_preface(data, "the key") if line is PREFACE else parse_line(data + b"\n")


def test_a_guard_tells_of_itself():
    """Of refused commands and stops it counts what is known here."""
    message = parse(
        GUARD,
        by="ann",
        refused={"held": 7, "unheard_of": 1},
        stops={"lost": 2, "unheard_of": 1},
        fence=13,
        answers="a1",
    )
    assert message.report == GuardReport(
        "ready", by="ann", refused=(("held", 7),), fence=13, stops=(("lost", 2),)
    )
    assert message.answers == "a1"
    assert parse(GUARD).answers is None
    assert parse(GUARD).report.fence == 0
    assert not parse(GUARD).report.blind_limits
    assert parse(GUARD, blind_limits=True).report.blind_limits


def test_a_time_beyond_its_bound_costs_no_session():
    seen = {"type": "seen", "fence": 13, "ages_ms": [140.0]}
    times = (None, 0.05, 60_001, 1e300)
    bounded = [parse(seen, slowed_s=slowed_s).slowed_s for slowed_s in times]
    assert bounded == [None, 0.05, MAX_SLOWED_S, MAX_SLOWED_S]


@pytest.mark.parametrize("x", [0.0, -1e9, 1.1e9, -1e308])
def test_a_place_that_no_robot_reaches_is_unknown_and_costs_no_session(x):
    """Else odometry that has gone wrong takes its robot offline as soon as somebody uses it."""
    position = parse({"type": "position"}, x=x, y=2.5).position
    assert position == ((x, 2.5) if abs(x) <= 1e9 else None)


@pytest.mark.parametrize(
    ("battery", "known"),
    [
        (None, None),
        ({"percent": 80.6, "charging": True}, Battery(81, charging=True)),
        ({"percent": 0, "charging": False}, Battery(0, charging=False)),
        ({"percent": None, "charging": True}, Battery(None, charging=True)),
    ],
)
def test_a_battery_is_known_in_whole_percent(battery, known):
    assert parse({"type": "vitals"}, battery=battery).rounded == known


HELP = {"type": "help", "source": "battery", "reason": "battery at 19 %"}


@pytest.mark.parametrize(
    ("changes", "call"),
    [
        ({}, HelpCall("battery", "battery at 19 %")),
        ({"source": "sonar", "priority": 0}, HelpCall("robot", "battery at 19 %", 1)),
        ({"priority": 10**30}, HelpCall("battery", "battery at 19 %", 3)),
        ({"reason": "<b>\n\x1b[2J\u202e"}, HelpCall("battery", "<b>  [2J")),
        ({"reason": "x" * 9000}, HelpCall("battery", "x" * MAX_HELP_REASON)),
    ],
)
def test_call_for_help_is_read_within_bounds(changes, call):
    """What a newer agent or a wicked robot says costs no session, and reaches nobody unbounded."""
    assert parse(HELP, **changes).call == call


@pytest.mark.parametrize(
    ("line", "field", "value"),
    [
        *((PREFACE, "kind", kind) for kind in ("exec", None, ["shell"])),
        *((PREFACE, "fingerprint", fingerprint) for fingerprint in (None, "x" * 65)),
        *((PREFACE, "ports", ports) for ports in (None, "20000", [20000, "20001"], [True])),
        *((PREFACE, "robot_id", robot_id) for robot_id in ("7", True, 7.5)),
        *((PREFACE, "address", address) for address in ("x" * 46, None)),
        *((HELP, "reason", reason) for reason in (None, 7)),
        *((GUARD, "refused", {"old": count}) for count in (-1, 2**53, True, "7", 1.5)),
        *((HELLO, "epoch", epoch) for epoch in (-1, 2**53 + 1, 1.5, "1", None)),
        (GUARD, "refused", ["old"]),
        (GUARD, "state", "asleep"),
        (GUARD, "stopped", 0),
        (GUARD, "by", "x" * 64),
        # Half a character would spoil the write of a whole batch of records, others steer terminals.
        *((GUARD, "by", text) for text in ("1\x1b[2J", "1\n", "1\u202e")),
        (HELLO, "agent_version", "1\x1b[2J"),
        (HELLO, "guard", "maybe"),
        (HEALTH, "ros", "fine"),
        (HEALTH, "ros_exposed", "no"),
        *((PING, "t_ms", clock) for clock in (-1, 1e300, 10**400, "now", True, None)),
        ({"type": "vitals"}, "battery", {"percent": 101, "charging": True}),
    ],
)
def test_a_wrong_field_of_a_line_is_named(line, field, value):
    with pytest.raises(ProtocolError, match=field) as refusal:
        parse(line, **{field: value})
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize(
    ("line", "missing"), [(HELLO, "guard"), (HEALTH, "ros_exposed"), (GUARD, "stopped")]
)
def test_what_a_line_does_not_say_is_not_taken_for_well(line, missing):
    with pytest.raises(ProtocolError, match=missing):
        parse({name: value for name, value in line.items() if name != missing})


@pytest.mark.parametrize("text", ["\\ud800", "\\udfff", "\\ud800x"])
def test_half_a_character_is_not_read(text):
    """It would spoil the write of a whole batch of records."""
    with pytest.raises(ProtocolError):
        parse_line(json.dumps(GUARD | {"by": "@"}).replace("@", text).encode())

"""The lines between cells, without a network."""

import json

import pytest
from relay_server import utc
from robotether_server.contract.robots import LiveState
from robotether_server.problems import ProtocolError
from robotether_server.relay.cells.messages import (
    PeerHello,
    PeerRobot,
    PeerStop,
    PeerStopEnd,
    build,
    parse,
)

# To the microsecond: it names the stop.
NOON = utc(2026, 1, 1, 12, 0, 0, 123456)
MESSAGES = {
    '{"type":"hello","cell":"a"}': PeerHello("a"),
    '{"type":"stop","robot_id":7,"at":"2026-01-01T12:00:00.123456Z","by":"ben","reason":null}': PeerStop(
        7, NOON, "ben"
    ),
    '{"type":"released","robot_id":7,"at":"2026-01-01T12:00:00.123456Z","by":"ben"}': PeerStopEnd(
        7, NOON, "ben"
    ),
}


@pytest.mark.parametrize("text", MESSAGES)
def test_messages_are_read_as_they_were_written(text):
    assert build(MESSAGES[text]) == text
    assert parse(text) == MESSAGES[text]


def test_members_that_an_older_cell_does_not_send_have_defaults():
    text = '{"type":"robot","robot_id":7,"epoch":12,"online":true,"object":{"ros":"ok"}}'
    robot = PeerRobot(7, 12, online=True, object=LiveState(ros="ok"))
    assert parse(text) == robot
    assert parse(build(robot)) == robot


def test_what_a_newer_cell_says_is_passed_over():
    assert parse('{"type":"weather","robot_id":7}') is None
    assert parse('{"type":"hello","cell":"a","weather":"fine"}') == PeerHello("a")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"type":7}',
        '{"type":"hello"}',
        '{"type":"robot","robot_id":"7","epoch":1,"online":true,"object":{}}',
        '{"type":"stop","robot_id":7,"at":"noon","by":"ben"}',
        json.dumps({"type": "released", "robot_id": 7}),
        "[" * 10_000,
    ],
)
def test_what_breaks_the_contract_is_no_message(text):
    """It must not be taken for one of a newer cell."""
    with pytest.raises(ProtocolError):
        parse(text)

"""Rubbish gets a status error and hurts nothing."""

import logging

import pytest
from sim_client import DirectClient
from sim_robot.rosbridge.operations import OPERATIONS


@pytest.mark.parametrize(
    "rubbish",
    [
        "",
        "{",
        "[]",
        "null",
        "5",
        '"x"',
        '{"op": NaN}',
        "[" * 100_000,
        b"\xff\xfe",
        b"\x00" * 50,
        "nonsense",
    ],
)
async def test_no_json_object(client: DirectClient, rubbish: str | bytes) -> None:
    """What is no JSON object is answered with an error."""
    (answer,) = await client.send_text(rubbish)
    assert (answer["op"], answer["level"]) == ("status", "error")
    assert "cannot read a message" in answer["msg"]


async def test_missing_op_lists_what_there_is(client: DirectClient) -> None:
    """A message without op is told all operations, with its id."""
    (answer,) = await client.send(id="m1", topic="/a")
    assert answer["id"] == "m1"
    assert all(name in answer["msg"] for name in OPERATIONS)


@pytest.mark.parametrize("name", ["dance", "", 5, [], {"a": 1}])
async def test_unknown_op(client: DirectClient, name: object) -> None:
    """An operation that does not exist is named in the error."""
    (answer,) = await client.send(op=name, id=3)
    assert (answer["op"], answer["level"], answer["id"]) == ("status", "error", 3)
    assert "Unknown operation" in answer["msg"]


async def test_error_names_operation_and_field(client: DirectClient) -> None:
    """A missing field is named after its operation."""
    assert await client.send(op="subscribe", id="s") == [
        {
            "op": "status",
            "level": "error",
            "msg": "subscribe: Expected a topic field but none was found",
            "id": "s",
        }
    ]


async def test_id_that_is_none_is_refused(client: DirectClient) -> None:
    """An object as id is an error that does not come back as an id."""
    (answer,) = await client.send(op="subscribe", topic="/a", type="std_msgs/String", id={})
    assert "id" not in answer
    assert client.graph.bus.topics() == {}


async def test_fault_of_the_simulator_is_logged(
    client: DirectClient, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An unexpected exception is logged with its traceback and told without it."""
    monkeypatch.setattr(client.graph.services, "get", lambda _name: {}["gone"])
    with caplog.at_level(logging.ERROR):
        (answer,) = await client.send(op="call_service", service="/a")
    assert answer["level"] == "error"
    assert "gone" not in answer["msg"]
    assert "KeyError" in caplog.text


async def test_binary_json_is_taken(client: DirectClient) -> None:
    """JSON in a binary frame works as in the real one."""
    (answer,) = await client.send_text(b'{"op": "call_service", "service": "/rosapi/get_time"}')
    assert answer["result"] is True

"""call_service."""

from typing import Any

import pytest
from sim_client import DirectClient
from sim_robot.services import Service


@pytest.fixture
def greeter(client: DirectClient) -> DirectClient:
    """A client of a robot with one service that has two arguments."""

    def greet(request: dict[str, Any]) -> dict[str, Any]:
        return {"text": f"{request['word']} {request['times']}"}

    request = (("word", "string"), ("times", "int32"))
    client.graph.services.add(Service("/greet", "test_srvs/Greet", "/n", request, greet))
    return client


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ({"word": "hi", "times": 2}, "hi 2"),
        (["hi", 2], "hi 2"),
        (["hi"], "hi 0"),
        ({}, " 0"),
        (None, " 0"),
    ],
)
async def test_args_by_name_and_by_order(greeter: DirectClient, args: object, text: str) -> None:
    """Arguments come as an object or as a list; missing ones have defaults."""
    assert await greeter.send(op="call_service", service="/greet", args=args, id="c1") == [
        {
            "op": "service_response",
            "service": "/greet",
            "values": {"text": text},
            "result": True,
            "id": "c1",
        }
    ]


async def test_no_id_no_id(greeter: DirectClient) -> None:
    """A call without an id is answered without one."""
    (answer,) = await greeter.send(op="call_service", service="/greet")
    assert "id" not in answer


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        ({"service": "/nope"}, "Service /nope does not exist"),
        ({"service": "/greet", "args": {"wrod": "x"}}, "test_srvs/srv/Greet has no field wrod"),
        ({"service": "/greet", "args": {"times": "x"}}, "times"),
        ({"service": "not a name"}, "not a name"),
    ],
)
async def test_failed_call_is_answered(
    greeter: DirectClient, call: dict[str, Any], reason: str
) -> None:
    """A call that cannot be done has result false and the reason in values."""
    (answer,) = await greeter.send(op="call_service", id=5, **call)
    assert (answer["op"], answer["result"], answer["id"]) == ("service_response", False, 5)
    assert reason in answer["values"]


async def test_missing_service_is_a_status_error(greeter: DirectClient) -> None:
    """Without a service there is nothing to respond for."""
    (answer,) = await greeter.send(op="call_service")
    assert (answer["op"], answer["level"]) == ("status", "error")

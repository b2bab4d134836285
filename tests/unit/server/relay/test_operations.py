"""Which operations pass, to the letter of the table."""

from __future__ import annotations

import json

import pytest
from robotether_server.relay.operations import (
    OBSERVER_RULES,
    refusal_of_binary,
    refusal_of_text,
    status_error,
)


def refused(message: object, mode: str = "observe") -> dict | None:
    data = message if isinstance(message, bytes) else json.dumps(message).encode()
    answer = refusal_of_text(data, mode)
    return None if answer is None else json.loads(answer)


@pytest.mark.parametrize("operation", ["subscribe", "unsubscribe", "status", "set_level"])
def test_an_observer_may_send_what_only_looks(operation):
    """Operations that change nothing on the robot pass."""
    assert refused({"op": operation}) is None


@pytest.mark.parametrize(
    "operation", sorted(OBSERVER_RULES.keys() - {"subscribe", "unsubscribe", "status", "set_level"})
)
def test_an_observer_may_send_nothing_else(operation):
    """Every other operation of the protocol is refused with the id and the reason."""
    answer = refused({"op": operation, "id": "x1", "service": "/reset"})
    assert answer is not None
    assert (answer["op"], answer["level"], answer["id"]) == ("status", "error", "x1")
    assert answer["msg"].startswith(f"cannot pass {operation}: ")


@pytest.mark.parametrize("operation", [*OBSERVER_RULES, "unheard_of", None, 7])
def test_a_driver_may_send_all(operation):
    """A drive connection's operations are rosbridge's business."""
    assert refused({"op": operation}, "drive") is None


@pytest.mark.parametrize("message", [{}, {"op": None}, {"op": ["subscribe"]}, {"op": "unheard_of"}])
def test_an_observer_sends_no_unknown_operation(message):
    """What is not in the table does not pass."""
    assert refused(message) is not None


@pytest.mark.parametrize(
    ("service", "passes"),
    [
        ("/rosapi/topics", True),
        ("/rosapi/topic_type", True),
        ("/rosapi/get_param", True),
        ("/rosapi/set_param", False),
        ("/rosapi/delete_param", False),
        ("/rosapi/", False),
        ("/rosapi/../reset", False),
        ("/rosapi/topics\n", False),
        ("/rosapix/topics", False),
        ("rosapi/topics", False),
        ("/robot/rosapi/topics", False),
        (None, False),
        (["/rosapi/topics"], False),
    ],
)
def test_an_observer_calls_only_look_ups_of_rosapi(service, passes):
    """Services outside /rosapi, and those in it that write, are refused."""
    answer = refused({"op": "call_service", "service": service})
    assert (answer is None) == passes


def test_a_repeated_key_cannot_hide_an_operation():
    """A message that two parsers may read differently does not pass an observer's check."""
    assert refused(b'{"op": "publish", "op": "subscribe"}') is not None
    assert refused(b'{"op": "subscribe", "a": {"b": 1, "b": 2}}') is not None


@pytest.mark.parametrize("mode", ["observe", "drive"])
@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"1", b"\xff\xfe", b"[" * 200_000])
def test_rubbish_passes_nobody(data, mode):
    """Text that is no JSON object is answered, and says so."""
    answer = refused(data, mode)
    assert answer is not None
    assert answer["msg"].startswith("cannot read message: not JSON")


def test_binary_passes_drivers_only():
    """Nothing checks binary messages, so observers send none."""
    assert refusal_of_binary("drive") is None
    assert refusal_of_binary("observe") is not None


def test_a_status_carries_only_ids_that_rosbridge_knows():
    """A text or number as id comes back; anything else does not."""
    assert json.loads(status_error("x", "a"))["id"] == "a"
    assert json.loads(status_error("x", 7))["id"] == 7
    assert "id" not in json.loads(status_error("x", {"big": "thing"}))
    assert "id" not in json.loads(status_error("x", None))

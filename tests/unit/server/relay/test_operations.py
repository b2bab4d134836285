"""Which operations pass, to the letter of the table, and what of them."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.relay.operations import (
    OBSERVER_OPERATIONS,
    PARSED_UP_TO_BYTES,
    RefusedError,
    checked_binary,
    checked_text,
    status_error,
)

# An observer's messages that pass, each with all that it may hold.
PASSING = [
    {"op": "subscribe", "topic": "/pose"},
    {
        "op": "subscribe",
        "id": "subscribe:/pose:1",
        "topic": "/pose",
        "type": "turtlesim/Pose",
        "throttle_rate": 100,
        "queue_length": 1,
        "qos": {"history": "keep_last", "depth": 1},
        "fragment_size": 100_000,
        "compression": "cbor",
    },
    {"op": "unsubscribe", "id": 7, "topic": "/pose"},
    {
        "op": "call_service",
        "id": "call_service:/rosapi/topic_type:2",
        "service": "/rosapi/topic_type",
        "args": {"topic": "/pose"},
        "timeout": 5.0,
        "compression": "none",
    },
    {"op": "call_service", "service": "/rosapi/topics", "args": []},
    {"op": "status", "id": "x", "level": "error", "msg": "what"},
    {"op": "set_level", "level": "warning"},
]
DRIVERS_OPERATIONS = [
    "advertise",
    "unadvertise",
    "publish",
    "advertise_service",
    "unadvertise_service",
    "service_response",
    "send_action_goal",
    "cancel_action_goal",
    "advertise_action",
    "unadvertise_action",
    "action_feedback",
    "action_result",
    "fragment",
    "png",
    "auth",
]


def sent(message: object, mode: str = "observe") -> object:
    """What reaches the robot; the answer to the client when nothing does."""
    data = message if isinstance(message, bytes) else json.dumps(message).encode()
    return json.loads(checked_text(data, mode))


def refused(message: object, mode: str = "observe") -> dict:
    with pytest.raises(RefusedError) as refusal:
        sent(message, mode)
    return json.loads(refusal.value.answer)


@pytest.mark.parametrize("message", PASSING, ids=lambda message: message["op"])
def test_an_observer_may_send_what_only_looks(message):
    """Operations that change nothing on the robot pass with all their fields."""
    assert sent(message) == message


@pytest.mark.parametrize("operation", DRIVERS_OPERATIONS)
def test_an_observer_may_send_nothing_else(operation):
    """Every other operation of the protocol is refused with the id and the reason."""
    answer = refused({"op": operation, "id": "x1", "topic": "/cmd_vel", "service": "/reset"})
    assert (answer["op"], answer["level"], answer["id"]) == ("status", "error", "x1")
    assert answer["msg"].startswith(f"cannot pass {operation}: ")


@pytest.mark.parametrize(
    "operation", [*OBSERVER_OPERATIONS, *DRIVERS_OPERATIONS, "unheard_of", None, 7]
)
def test_a_driver_may_send_all(operation):
    """A drive connection's operations are rosbridge's business, to the byte."""
    data = json.dumps({"op": operation, "message_intervall": 1}, indent=3).encode()
    assert checked_text(data, "drive") is data


@pytest.mark.parametrize("message", [{}, {"op": None}, {"op": ["subscribe"]}, {"op": "unheard_of"}])
def test_an_observer_sends_no_unknown_operation(message):
    """What is not in the table does not pass."""
    assert "may not send this operation" in refused(message)["msg"]


@pytest.mark.parametrize("message", PASSING, ids=lambda message: message["op"])
def test_only_known_fields_go_on(message):
    """What rosbridge takes from any message, and what nobody knows, is left out."""
    more = {"message_intervall": 3600, "png": "png", "msgs": {"op": "publish"}, "x": [[[]]]}
    assert sent(more | message) == message


@pytest.mark.parametrize(
    "message", [m for m in PASSING if len(m) > 2], ids=lambda message: message["op"]
)
def test_a_field_of_another_type_is_named(message):
    """No field may hold a nested object; the refusal tells which one did."""
    for name in message.keys() - {"op"}:
        answer = refused(message | {name: {"a": {"op": "publish"}}})
        assert answer["msg"].startswith(f"cannot pass {message['op']}: its field {name} ")


@pytest.mark.parametrize("operation", ["subscribe", "unsubscribe", "call_service"])
def test_the_field_that_says_what_is_needed(operation):
    """Without topic or service there is nothing to check."""
    assert "its field" in refused({"op": operation})["msg"]


def test_a_field_that_is_null_counts_as_absent():
    """Clients write null for what they do not want."""
    message = {"op": "subscribe", "topic": "/pose", "type": None, "compression": None}
    assert sent(message) == {"op": "subscribe", "topic": "/pose"}


@pytest.mark.parametrize(
    ("service", "passes"),
    [
        ("/rosapi/topics", True),
        ("/rosapi/topic_type", True),
        ("/rosapi/get_param", True),
        ("/rosapi/get_time", True),
        ("/rosapi/set_param", False),
        ("/rosapi/delete_param", False),
        ("/rosapi/set_logger_level", False),
        ("/rosapi/set_logger_levels", False),
        ("/rosapi/set_parameters", False),
        ("/rosapi/unheard_of", False),
        ("/rosapi/topics#1", False),
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
    """Services outside /rosapi, those in it that write, and those nobody knows are refused."""
    message = {"op": "call_service", "service": service}
    if passes:
        assert sent(message) == message
    else:
        assert "no look-up of /rosapi" in refused(message)["msg"]


def test_a_repeated_key_cannot_hide_an_operation():
    """A message that two parsers may read differently does not pass an observer's check."""
    assert "stands in it twice" in refused(b'{"op": "publish", "op": "subscribe"}')["msg"]
    refused(b'{"op": "subscribe", "topic": "/a", "a": {"b": 1, "b": 2}}')


@pytest.mark.parametrize("mode", ["observe", "drive"])
@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"1", b"\xff\xfe", b"[" * 200_000, b"{" + b"\xff" * 70_000 + b"}"]
)
def test_rubbish_passes_nobody(data, mode):
    """Text that is no JSON object is answered, and says so."""
    assert refused(data, mode)["msg"].startswith("cannot read message: not JSON")


def test_a_drivers_large_text_is_not_parsed(monkeypatch):
    """Parsing would hold up all other connections, so only its ends are looked at."""
    monkeypatch.setattr("robotether_server.relay.operations.json.loads", None)
    data = b' {"op": "publish", "msg": [' + b"[]," * PARSED_UP_TO_BYTES + b"1]}\n"
    assert checked_text(data, "drive") is data


def test_binary_passes_drivers_only():
    """Nothing checks binary messages, so observers send none."""
    assert checked_binary(b"\x00", "drive") == b"\x00"
    with pytest.raises(RefusedError):
        checked_binary(b"\x00", "observe")


def test_a_status_carries_only_ids_that_rosbridge_knows():
    """A text or number as id comes back; anything else does not."""
    assert json.loads(status_error("x", "a"))["id"] == "a"
    assert json.loads(status_error("x", 7))["id"] == 7
    assert "id" not in json.loads(status_error("x", {"big": "thing"}))
    assert "id" not in json.loads(status_error("x", None))


def strict_loads(text: str) -> object:
    """Parse as the strictest robot may: few levels, 64 bits, no NaN, no half characters."""

    def number(digits: str) -> int:
        if not -(2**63) <= int(digits) < 2**63:
            raise ValueError(digits)
        return int(digits)

    def constant(name: str) -> float:
        raise ValueError(name)

    value = json.loads(text, parse_int=number, parse_constant=constant)
    if text.count("{") + text.count("[") > 8 or "inf" in repr(value):
        raise ValueError("nested too deep, or too large")
    json.dumps(value, ensure_ascii=False).encode()
    return value


def run_by_rosbridge(text: str) -> list[object]:
    """The operations that rosbridge may run of a text: it, or any object inside when it fails."""
    try:
        return [strict_loads(text)]
    except ValueError:
        return list(_inner_operations(text))


def _inner_operations(text: str) -> Iterator[object]:
    ends = [place + 1 for place, letter in enumerate(text) if letter == "}"]
    for start in (place for place, letter in enumerate(text) if letter == "{"):
        for end in ends:
            try:
                inner = strict_loads(text[start:end])
            except ValueError:
                continue
            if isinstance(inner, dict) and "op" in inner:
                yield inner


HIDDEN = '{"op": "publish", "topic": "/cmd_vel", "msg": {}}'
UNCLEAR = ["1" * 30, "NaN", "1e999", "[" * 50 + "]" * 50, '"\\ud800"', "-Infinity"]


@pytest.mark.parametrize("unclear", UNCLEAR)
@pytest.mark.parametrize(
    "message",
    [
        '{"op": "subscribe", "topic": "/a", "x": UNCLEAR, "y": HIDDEN}',
        '{"op": "subscribe", "topic": "/a", "qos": {"depth": UNCLEAR}, "y": HIDDEN}',
        '{"op": "subscribe", "topic": "/a", "id": UNCLEAR, "qos": HIDDEN}',
        '{"op": "call_service", "service": "/rosapi/nodes", "args": {"a": UNCLEAR, "b": HIDDEN}}',
        '{"op": "call_service", "service": "/rosapi/nodes", "args": [UNCLEAR, HIDDEN]}',
        '{"op": "call_service", "service": "/rosapi/nodes", "id": UNCLEAR, "args": HIDDEN}',
    ],
)
def test_no_operation_hides_in_what_a_robot_cannot_parse(message, unclear):
    """What this parser reads and the robot's refuses makes rosbridge run nothing but the checked."""
    text = message.replace("UNCLEAR", unclear).replace("HIDDEN", HIDDEN)
    assert {"op": "publish", "topic": "/cmd_vel", "msg": {}} in run_by_rosbridge(text)
    try:
        passed = checked_text(text.encode(), "observe").decode()
    except RefusedError:
        return
    assert [operation["op"] for operation in run_by_rosbridge(passed)] == [json.loads(text)["op"]]


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.just("{"),
    lambda inner: (
        st.lists(inner) | st.dictionaries(st.sampled_from(["op", "topic", "id"]) | st.text(), inner)
    ),
    max_leaves=8,
)
FIELD_NAMES = sorted({name for known in OBSERVER_OPERATIONS.values() for name in known})


@given(
    st.sampled_from(sorted(OBSERVER_OPERATIONS)),
    st.dictionaries(st.sampled_from(FIELD_NAMES) | st.text(), JSON_VALUES),
    st.sampled_from(["/rosapi/topics", "/rosapi/set_param", "/reset"]),
)
def test_whatever_an_observer_sends_means_one_thing(operation, others, service):
    """What passes is one flat message that the strictest parser reads, of the checked operation."""
    message = {"topic": "/a", **others, "service": service, "op": operation}
    try:
        passed = checked_text(json.dumps(message).encode(), "observe").decode()
    except RefusedError:
        return
    (run,) = run_by_rosbridge(passed)
    assert run == json.loads(passed)
    assert run["op"] == operation
    assert run.get("service", "/rosapi/topics") == "/rosapi/topics"
    assert run.keys() <= {"op", *OBSERVER_OPERATIONS[operation]}

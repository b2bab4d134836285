"""Which operations pass for which level, and what of them, and nothing beside in any spelling."""

import json
import math
import re

import pytest
from robotether_server.relay.channels.rosbridge.drive_path import DriveStamp, stamped
from robotether_server.relay.channels.rosbridge.message_validator import status_error
from robotether_server.relay.channels.rosbridge.operations import (
    OPERATIONS,
    ROSAPI_LOOKUPS_OF_DRIVERS,
)
from validators import DRIVING, MANAGING, OBSERVING, check, name_of, refused, sent, validator


def test_each_operation_has_an_example():
    """So what each level sends holds for all."""
    examples = {name_of(message) for message in OBSERVING + DRIVING + MANAGING}
    assert examples == {name for name, entry in OPERATIONS.items() if not entry.own}


def test_the_policy_says_which_names():
    """What it does not name, the test with random names of hidden operations holds."""
    policy = {"observe": {"subscribe": ["/camera/*"]}, "drive": {"call": ["/dock", "/arm/*"]}}
    sent({"op": "subscribe", "topic": "/camera/a/b"}, validator("observe", {"policy": policy}))
    for name in ("/dock", "/arm/up"):
        sent({"op": "call_service", "service": name}, validator("drive", {"policy": policy}))
        sent({"op": "send_action_goal", "action": name}, validator("drive", {"policy": policy}))


def test_look_ups_write_nothing():
    writing = re.compile("set|delete|add|remove|load|call|publish_|kill|write")
    assert [name for name in ROSAPI_LOOKUPS_OF_DRIVERS if writing.search(name)] == []


@pytest.mark.parametrize(
    ("level", "passing", "refused_messages", "why"),
    [
        ("observe", OBSERVING, DRIVING + MANAGING, "an observing connection only subscribes"),
        ("drive", OBSERVING + DRIVING, MANAGING, "the robot's policy does not let you"),
        ("manage", OBSERVING + DRIVING + MANAGING, [], ""),
    ],
)
def test_a_level_sends_what_it_may_and_no_more(level, passing, refused_messages, why):
    """Drive topics need not stand in the policy."""
    for message in passing:
        assert sent(message, validator(level)) == message
    for message in refused_messages:
        kind, answer = refused({**message, "id": "x1"}, validator(level))
        assert kind == ("topic" if "topic" in message else "service")
        assert (answer["op"], answer["level"], answer["id"]) == ("status", "error", "x1")
        assert why in str(answer["msg"])


@pytest.mark.parametrize(
    "name",
    ["", "/", "~pose", "~/pose", "/a//b", "//a", "/a/", "/a b", "/a\n", "/a/../b", "/ä", "/a#1",
     "/" + "a" * 255, 7, None, ["/a"], {"a": 1}, "/a\x00", "{ns}/a", "/a/~b"],
)  # fmt: skip
def test_no_other_spelling_of_a_name_passes(name):
    """The robot could read another name in it; so says the refusal."""
    for level in ("observe", "manage"):
        kind, answer = refused({"op": "subscribe", "topic": name}, validator(level))
        assert kind == "shape"
        assert "its field topic is not a full name" in str(answer["msg"])


@pytest.mark.parametrize(
    "operation", ["fragment", "png", "auth", "unheard_of", "Publish", "", None, 7, ["publish"]]
)
@pytest.mark.parametrize("level", ["observe", "drive", "manage"])
def test_nobody_sends_an_unknown_operation(operation, level):
    kind, answer = refused(
        {"op": operation, "id": 3, "data": '{"op": "publish"}'}, validator(level)
    )
    assert (kind, answer["id"]) == ("operation", 3)
    assert str(answer["msg"]).startswith("cannot pass ")


@pytest.mark.parametrize("message", OBSERVING + DRIVING + MANAGING, ids=name_of)
def test_a_field_of_another_type_is_named(message):
    for name in message.keys() - {"op"}:
        wrong = 7.5 if name in {"args", "msg", "values"} else {"a": {"op": "publish"}}
        kind, answer = refused({**message, name: wrong}, validator("manage"))
        assert kind == "shape"
        assert str(answer["msg"]).startswith(f"cannot pass {message['op']}: its field {name} ")


@pytest.mark.parametrize(
    "operation", [name for name, entry in OPERATIONS.items() if entry.named_by is not None]
)
def test_the_field_that_says_what_is_needed(operation):
    assert refused({"op": operation}, validator("manage"))[0] == "shape"


def test_a_field_that_is_null_counts_as_absent():
    message = {"op": "subscribe", "topic": "/pose", "type": None, "compression": None}
    assert sent(message, validator()) == {"op": "subscribe", "topic": "/pose"}


LOOK_UPS = {
    "observe": ["topics", "topic_type", "get_time"],
    "drive": ["topics", "topic_type", "get_time", "get_param", "get_param_names", "service_type"],
}
WRITING = ["set_param", "delete_param", "set_logger_level", "set_parameters", "unheard_of"]
ELSEWHERE = ["/rosapix/topics", "/robot/rosapi/topics"]


@pytest.mark.parametrize("level", LOOK_UPS)
def test_who_may_call_nothing_calls_look_ups(level):
    """An observer's look-ups ask no other node, which may hang; services that write, and unknown ones, are refused."""
    for name in LOOK_UPS[level]:
        for service in (f"/rosapi/{name}", f"rosapi/{name}"):
            passed = sent({"op": "call_service", "service": service}, validator(level))
            assert passed == {"op": "call_service", "service": f"/rosapi/{name}"}
    others = {*LOOK_UPS["drive"], *WRITING} - {*LOOK_UPS[level]}
    for service in [*(f"/rosapi/{name}" for name in others), *ELSEWHERE]:
        message = {"op": "call_service", "service": service}
        assert refused(message, validator(level))[0] == "service"


def test_a_look_up_takes_plain_values():
    """An observer sends no object inside another, in which an operation might hide."""
    for args in ({"a": {}}, [[]], {"op": "publish"}, [{"op": "publish"}]):
        message = {"op": "call_service", "service": "/rosapi/topics", "args": args}
        assert refused(message, validator())[0] == "shape"
        assert sent(message, validator("manage")) == message


def test_our_own_operations_go_no_further():
    own = {"op": "robotether.clock_sync", "t_ms": 81.0, "key": "k"}
    clock_sync = check({**own, "x": 1}, validator())
    assert (clock_sync.data, clock_sync.drive, clock_sync.own) == (b"", None, own)
    for field, values in {
        "key": (1, ["k"], "k" * 1025),
        "t_ms": ("81", True, 1e300, [1]),
    }.items():
        for value in values:
            assert refused({**own, field: value}, validator())[0] == "shape"
    assert refused({"op": "robotether.control"}, validator("manage"))[0] == "operation"


def test_a_drive_command_is_recognised():
    message = {
        "op": "publish",
        "topic": "left/cmd_vel",
        "msg": {"linear": {"x": 3, "y": 4}, "angular": {"z": -0.5}},
        "robotether": {"t_ms": 12.5, "fence": 99},
    }
    checked = check(message, validator("drive"))
    command = checked.drive
    assert (command.topic, command.stamp) == ("/left/cmd_vel", DriveStamp(12.5))
    assert (command.speed_m_s, command.turn_rad_s) == (5.0, 0.5)
    assert "robotether" not in json.loads(checked.data)
    assert json.loads(stamped(command, 81.25, 13)) == {
        **message,
        "topic": "/left/cmd_vel",
        "robotether": {"t_ms": 81.25, "fence": 13},
    }


@pytest.mark.parametrize(
    ("msg", "reason"),
    [({"data": "x"}, "is neither a Twist"), ({"linear": {"x": "1"}}, "not a finite number")],
)
def test_a_drive_topic_takes_commands_only(msg, reason):
    for level in ("drive", "manage"):
        kind, answer = refused({"op": "publish", "topic": "/cmd_vel", "msg": msg}, validator(level))
        assert kind == "shape"
        assert reason in str(answer["msg"])


def test_a_status_carries_only_ids_that_rosbridge_knows():
    assert json.loads(status_error("x", "a"))["id"] == "a"
    assert json.loads(status_error("x", 7))["id"] == 7
    for no_id in ({"big": "thing"}, None, "x" * 2000, math.nan):
        assert "id" not in json.loads(status_error("x", no_id))

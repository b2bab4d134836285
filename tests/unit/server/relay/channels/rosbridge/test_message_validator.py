"""Which operations pass for which level, and what of them, and nothing beside in any spelling."""

import re

import pytest
from robotether_server.relay.channels.rosbridge.operations import (
    ROSAPI_LOOKUPS_OF_DRIVERS,
)
from validators import DRIVING, MANAGING, OBSERVING, name_of, refused, sent, validator


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
        assert (answer["id"], why in words_of(message, answer)) == ("x1", True)


def test_who_may_send_goals_may_cancel_them_all():
    at = validator("drive", {"policy": {"drive": {"call": ["/go"]}}})
    for action in ("/go", "/fetch"):
        message = {"op": "call_service", "service": f"{action}/_action/cancel_goal", "args": {}}
        if action == "/go":
            assert sent(message, at) == message
        else:
            assert refused(message, at)[0] == "service"


def words_of(message, answer):
    """Return why a message is refused, as rosbridge answers what failed: who calls waits for nothing else."""
    if message["op"] == "call_service":
        assert answer["op"] == "service_response"
    elif message["op"] == "send_action_goal":
        assert (answer["op"], answer["status"]) == ("action_result", 0)
    else:
        assert (answer["op"], answer["level"]) == ("status", "error")
        return answer["msg"]
    assert answer["result"] is False
    return answer["values"]


@pytest.mark.parametrize("message", OBSERVING + DRIVING + MANAGING, ids=name_of)
def test_a_field_of_another_type_is_named(message):
    for name in message.keys() - {"op"}:
        wrong = 7.5 if name in {"args", "msg", "values"} else {"a": {"op": "publish"}}
        kind, answer = refused({**message, name: wrong}, validator("manage"))
        assert kind == "shape"
        why = f"cannot pass {message['op']}: its field {name} "
        assert words_of(message, answer).startswith(why)
    for operation in (None, 7, ["publish"], "fragment"):
        assert refused({**message, "op": operation}, validator("manage"))[0] == "operation"


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

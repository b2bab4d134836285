"""What the buttons of a drive page may be."""

import drive_settings
import pytest
from drive_settings import LIGHTS
from robotether_server.problems import FieldInvalidError
from robotether_server.settings.buttons import MAX_BUTTONS, MAX_FIELDS_BYTES, parse, parse_one

DOCK = {**drive_settings.DOCK, "type": ""}


def nested(depth):
    return {"a": nested(depth - 1)} if depth > 1 else {}


def test_buttons_can_be_compared_and_be_keys():
    """True is no 1, and the order of members means nothing."""
    first, same = ({**LIGHTS, "msg": msg} for msg in ({"a": 1, "b": 2}, {"b": 2, "a": 1}))
    assert hash(parse_one(first)) == hash(parse_one(same))
    assert parse_one(first) == parse_one(same)
    assert parse_one(LIGHTS) != parse_one({**LIGHTS, "msg": {"data": 1}})


@pytest.mark.parametrize("ros_type", ["std_msgs/Bool", "std_msgs/msg/Bool", "std_srvs/srv/Trigger"])
def test_types_are_those_of_either_ros(ros_type):
    assert parse_one({**LIGHTS, "type": ros_type}).type == ros_type


UNREADABLE = ({"a": [[{"b": float("nan")}]]}, {"a": float("inf")}, {"a": 2**64}, {"a": "\ud800"})
WRONG = {
    "name": ("", "a" * 41),
    "kind": ("subscribe",),
    "topic": ("lights", "/lights*"),
    "type": ("", "Bool"),
    "msg": ([], "{}", nested(17), {"a": "x" * MAX_FIELDS_BYTES}, *UNREADABLE),
}


@pytest.mark.parametrize(
    ("button", "member", "value"),
    [
        *((LIGHTS, member, value) for member, values in WRONG.items() for value in values),
        (DOCK, "service", ""),
        (DOCK, "type", "Trigger"),
    ],
)
def test_a_wrong_value_is_named(button, member, value):
    with pytest.raises(FieldInvalidError, match=rf"cannot use buttons\.2\.{member}: "):
        parse([{**button, "name": "Other"}, {**button, member: value}])


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({}, "buttons: it must be a list"),
        ([LIGHTS] * (MAX_BUTTONS + 1), "buttons: it must be a list of at most"),
        ([LIGHTS, {**DOCK, "name": "Lights on"}], "buttons: there are two of the name 'Lights on'"),
        ([LIGHTS, "Dock"], "buttons.2: it must be a JSON object"),
        ([{**LIGHTS, "service": "/dock"}], "buttons.1: 'service' is not a setting"),
        ([{**DOCK, "msg": {}}], "buttons.1: 'msg' is not a setting"),
    ],
)
def test_what_is_no_list_of_buttons_is_refused(given, why):
    """A name stands once, and a button has the members of its kind alone."""
    with pytest.raises(FieldInvalidError, match=f"cannot use {why}"):
        parse(given)

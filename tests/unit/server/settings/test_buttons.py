"""What the buttons of a drive page may be."""

import drive_settings
import pytest
from drive_settings import LIGHTS
from robotether_server.problems import FieldInvalidError
from robotether_server.settings.buttons import MAX_FIELDS_BYTES, parse, parse_one

DOCK = {**drive_settings.DOCK, "type": ""}


def nested(depth):
    return {"a": nested(depth - 1)} if depth > 1 else {}


def test_buttons_can_be_compared():
    """True is no 1, and the order of members means nothing."""
    first, same = ({**LIGHTS, "msg": msg} for msg in ({"a": 1, "b": 2}, {"b": 2, "a": 1}))
    assert parse_one(first) == parse_one(same)
    assert parse_one(LIGHTS) != parse_one({**LIGHTS, "msg": {"data": 1}})


@pytest.mark.parametrize(
    ("button", "member", "value"),
    [
        (LIGHTS, "name", "a" * 41),
        (LIGHTS, "kind", "subscribe"),
        (LIGHTS, "topic", "/lights*"),
        (LIGHTS, "type", ""),
        (LIGHTS, "msg", []),
        (LIGHTS, "msg", nested(17)),
        (LIGHTS, "msg", {"a": "x" * MAX_FIELDS_BYTES}),
        (LIGHTS, "msg", {"a": [[{"b": float("nan")}]]}),
        (LIGHTS, "msg", {"a": 2**64}),
        (LIGHTS, "msg", {"a": "\ud800"}),
        (DOCK, "service", ""),
        (DOCK, "type", "Trigger"),
    ],
)
def test_a_wrong_value_is_named(button, member, value):
    with pytest.raises(FieldInvalidError, match=rf"cannot use buttons\.2\.{member}: "):
        parse([{**button, "name": "Other"}, {**button, member: value}])

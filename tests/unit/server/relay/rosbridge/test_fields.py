"""What a field of a client's message may hold."""

from __future__ import annotations

import json

import pytest
from robotether_server.relay.rosbridge import fields
from robotether_server.relay.rosbridge.fields import MAX_TEXT_LENGTH, FieldRefusedError


@pytest.mark.parametrize("value", ["", "/pose", "ü\n\0", "x" * MAX_TEXT_LENGTH])
def test_a_text_passes_as_it_is(value):
    """Texts of any characters pass up to their length."""
    assert fields.text(value) == value


@pytest.mark.parametrize("value", [None, 1, ["a"], {}, "x" * (MAX_TEXT_LENGTH + 1), "\ud800"])
def test_what_is_no_text_is_refused(value):
    """Half a character is none: some parsers refuse the whole message for it."""
    with pytest.raises(FieldRefusedError):
        fields.text(value)


def test_numbers_have_bounds():
    """Both ends pass, what lies outside or is no number does not."""
    assert [fields.whole(0, 9)(value) for value in (0, 9)] == [0, 9]
    assert fields.number(0, 9)(9) == 9.0
    for value in (-1, 10, True, "1", None):
        for check in (fields.whole(0, 9), fields.number(0, 9)):
            with pytest.raises(FieldRefusedError):
                check(value)
    with pytest.raises(FieldRefusedError):
        fields.whole(0, 9)(1.0)
    with pytest.raises(FieldRefusedError):
        fields.number(0, 9)(float("nan"))


@pytest.mark.parametrize("value", ["C", "a ", None, 1, ["a"], {}])
def test_only_the_listed_words_are_a_choice(value):
    """One of the words passes, anything else does not."""
    assert fields.choice("a", "b")("b") == "b"
    with pytest.raises(FieldRefusedError):
        fields.choice("a", "b")(value)


@pytest.mark.parametrize("value", ["x1", 7, -(2**63), 2**63 - 1])
def test_an_id_is_a_text_or_a_number(value):
    """An id passes as it is."""
    assert fields.identity(value) == value


@pytest.mark.parametrize("value", [2**63, 1.5, True, None, [], {}, "\udfff"])
def test_what_is_no_id_is_refused(value):
    """Other types and large numbers are no ids."""
    with pytest.raises(FieldRefusedError):
        fields.identity(value)


@pytest.mark.parametrize(
    "value", [{}, [], ["a", 1, None], {"topic": "/a", "depth": 5, "x": 1.5, "y": True, "z": None}]
)
def test_plain_values_pass_as_they_are(value):
    """Objects and arrays of texts, numbers and truth values pass."""
    assert fields.scalars(value) == value


@pytest.mark.parametrize(
    "value",
    [
        None,
        "text",
        {"a": {}},
        {"a": []},
        [[]],
        [{}],
        {"op": "publish"},
        {"": 1},
        {"a b": 1},
        {"a\n": 1},
        {"x": 2**63},
        {"x": json.loads("1e999")},
        {"x": json.loads("NaN")},
        {"x": "\ud800"},
    ],
)
def test_nothing_nested_or_unclear_passes(value):
    """No inner object, no member `op`, no number that parsers disagree on."""
    with pytest.raises(FieldRefusedError):
        fields.scalars(value)


@pytest.mark.parametrize(
    ("value", "name"),
    [("/a", "/a"), ("a", "/a"), ("/a/b_1", "/a/b_1"), ("a/2", "/a/2"), ("/_x", "/_x")],
)
def test_a_name_gets_its_first_slash(value, name):
    """What goes on is a full name."""
    assert fields.ros_name(value) == name


@pytest.mark.parametrize(
    "value", ["", "/", "~a", "/a/", "//a", "/a//b", "/a.b", "/a\n", "/é", "/a b", "/" + "a" * 255, None, 7, []]
)  # fmt: skip
def test_no_other_spelling_is_a_name(value):
    """Nothing that stands for another name, and nothing too long."""
    with pytest.raises(FieldRefusedError):
        fields.ros_name(value)


@pytest.mark.parametrize(
    ("check", "passes", "refused"),
    [
        (fields.flag, [True, False], [0, 1, "true", None]),
        (fields.members, [{}, {"op": {"x": [1]}}], [[], "x", 1, None]),
        (fields.payload, [{}, [], [{"op": 1}]], ["x", 1, None]),
        (fields.timestamp, [0, -1.5, 2**53], [2**60, True, "1", None, float("nan"), float("inf")]),
    ],
)
def test_each_type_passes_as_it_is(check, passes, refused):
    """And nothing of another type does."""
    assert [check(value) for value in passes] == passes
    for value in refused:
        with pytest.raises(FieldRefusedError):
            check(value)


def test_a_stamp_is_its_timestamp():
    """Whatever else stands beside it."""
    assert fields.stamp({"t_ms": 12, "fence": 3}) == 12.0
    for value in (None, 12, {}, {"t_ms": None}, {"t_ms": float("nan")}, [{"t_ms": 1}]):
        with pytest.raises(FieldRefusedError):
            fields.stamp(value)


TWIST = {"linear": {"x": 3, "y": 4.0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -2}}


@pytest.mark.parametrize(
    ("msg", "speed", "turn"),
    [
        (TWIST, 5.0, 2.0),
        ({"linear": {"x": -1}}, 1.0, 0.0),
        ({"angular": {}}, 0.0, 0.0),
        ({}, 0.0, 0.0),
        ({"header": {"frame_id": "base"}, "twist": TWIST}, 5.0, 2.0),
        ({"header": {}}, 0.0, 0.0),
        ({"drive": {"speed": -1.5, "steering_angle": 0.3}}, 1.5, None),
        ({"header": {}, "drive": {}}, 0.0, None),
    ],
)
def test_each_shape_has_its_speeds(msg, speed, turn):
    """Speed and turn are lengths; what is missing is zero."""
    assert fields.speeds(msg) == (speed, turn)


@pytest.mark.parametrize(
    "msg",
    [
        {"data": 1},
        {"linear": TWIST["linear"], "twist": TWIST},
        {"twist": TWIST, "drive": {}},
        {"twist": {"linear": {}, "header": {}}},
        {"linear": None},
        {"linear": [1, 2, 3]},
        {"linear": {"x": 1, "w": 1}},
        {"linear": {"x": None}},
        {"linear": {"x": True}},
        {"linear": {"x": "1"}},
        {"linear": {"x": float("inf")}},
        {"linear": {"x": 1.7e308, "y": 1.7e308}},
        {"angular": {"z": float("nan")}},
        {"twist": {"angular": {"z": []}}},
        {"drive": {"speed": None}},
        {"drive": {"speed": 1, "steering_angle": "left"}},
        {"drive": {"velocity": 1}},
        {"drive": 1},
    ],
)
def test_what_is_no_command_is_refused(msg):
    """Two shapes at once, unknown members, and anything that is no finite number."""
    with pytest.raises(FieldRefusedError):
        fields.speeds(msg)

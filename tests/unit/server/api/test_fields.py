"""Typed getters for fields from outside."""

from __future__ import annotations

import pytest
from flask import Request
from robotether_server.api import fields
from robotether_server.problems import FieldInvalid, HttpProblem
from werkzeug.test import EnvironBuilder


def test_text_loses_the_space_around_it() -> None:
    """A key line may come with its newline."""
    assert fields.text({"key": " a b\n"}, "key", 5) == "a b"


@pytest.mark.parametrize("value", [None, 1, [], "", "  ", "abcdef", "a\nb", "a\x00"])
def test_anything_else_is_refused_by_name(value: object) -> None:
    """Missing, of another type, empty, too long, not printable."""
    with pytest.raises(FieldInvalid, match="cannot use key: "):
        fields.text({"key": value}, "key", 5)


def test_optional_text_may_be_missing_or_null() -> None:
    """But not wrong."""
    assert fields.optional_text({}, "key", 5) is None
    assert fields.optional_text({"key": None}, "key", 5) is None
    with pytest.raises(FieldInvalid):
        fields.optional_text({"key": ""}, "key", 5)


@pytest.mark.parametrize("value", [None, "c", ["a"], 1])
def test_choice_tells_what_is_allowed(value: object) -> None:
    """The sentence lists the choices."""
    assert fields.choice({"key": "a"}, "key", ("a", "b")) == "a"
    with pytest.raises(FieldInvalid, match="one of a, b"):
        fields.choice({"key": value}, "key", ("a", "b"))


def asked(**options: object) -> Request:
    """A request as Flask sees it."""
    return Request(EnvironBuilder("/", **options).get_environ())  # type: ignore[arg-type] # werkzeug's own options


def test_body_is_one_json_object() -> None:
    """Any JSON type does, as programs send several."""
    for kind in (
        "application/json",
        "application/json; charset=utf-8",
        "application/merge-patch+json",
    ):
        body = fields.json_object(asked(method="POST", data=b'{"a": 1}', content_type=kind), ("a",))
        assert body == {"a": 1}


@pytest.mark.parametrize("kind", [None, "text/plain", "application/x-www-form-urlencoded"])
def test_body_that_is_not_sent_as_json_is_refused(kind: str | None) -> None:
    """415, and what to send."""
    with pytest.raises(HttpProblem, match="application/json") as refused:
        fields.json_object(asked(method="POST", data=b"{}", content_type=kind))
    assert refused.value.status == 415


def test_where_programs_are_simple_the_type_does_not_matter() -> None:
    """`curl -d` calls everything a form."""
    request = asked(
        method="POST", data=b'{"a": 1}', content_type="application/x-www-form-urlencoded"
    )
    assert fields.json_object(request, any_type=True) == {"a": 1}


@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"\xff\xfe", b"null", b"[" * 60000, b"1" * 5000]
)
def test_body_that_is_no_object_is_refused(data: bytes) -> None:
    """Broken, deep or long: a wrong body, not a failure of the server."""
    with pytest.raises(FieldInvalid, match="one JSON object"):
        fields.json_object(asked(method="POST", data=data, content_type="application/json"))


def test_member_that_nobody_reads_is_named() -> None:
    """A typo does not pass silently."""
    request = asked(method="POST", data=b'{"naem": "x"}', content_type="application/json")
    with pytest.raises(FieldInvalid, match="'naem': there is no such field; known are name, role"):
        fields.json_object(request, ("name", "role"))
    assert fields.json_object(request) == {"naem": "x"}


def test_query_has_each_name_once() -> None:
    """A name that is unknown or stands twice is refused."""
    assert fields.query(asked(query_string="a=1"), ("a", "b")) == {"a": "1"}
    for wrong in ("c=1", "a=1&a=2"):
        with pytest.raises(FieldInvalid):
            fields.query(asked(query_string=wrong), ("a", "b"))


@pytest.mark.parametrize("value", [1, 10, 5.0])
def test_number_within_bounds(value: object) -> None:
    """5.0 is a whole number to JSON."""
    found = fields.number({"key": value}, "key", 1, 10)
    assert (found, type(found)) == (value, int)


@pytest.mark.parametrize(
    "value", [None, 0, 11, 1.5, True, "5", float("nan"), float("inf"), 10**400]
)
def test_number_out_of_bounds_is_refused(value: object) -> None:
    """Truth values and texts are no numbers."""
    with pytest.raises(FieldInvalid, match="whole number from 1 to 10"):
        fields.number({"key": value}, "key", 1, 10)


@pytest.mark.parametrize("value", ["0", "11", "1.0", "+5", "5_0", "\u0665", "x", "", "9" * 5000])
def test_number_in_a_query_is_plain_digits(value: str) -> None:
    """Python takes more for a number than people mean."""
    assert fields.number_in_query({}, "key", 1, 10) is None
    assert fields.number_in_query({"key": "7"}, "key", 1, 10) == 7
    with pytest.raises(FieldInvalid, match="whole number from 1 to 10"):
        fields.number_in_query({"key": value}, "key", 1, 10)


def test_flag_is_true_or_false() -> None:
    """Nothing that merely counts as one."""
    assert fields.flag({"key": False}, "key") is False
    for value in (None, 0, 1, "true"):
        with pytest.raises(FieldInvalid, match="true or false"):
            fields.flag({"key": value}, "key")


def test_mapping_is_an_object() -> None:
    """Not a list of pairs."""
    assert fields.mapping({"key": {}}, "key") == {}
    with pytest.raises(FieldInvalid, match="JSON object"):
        fields.mapping({"key": []}, "key")


def test_secret_is_taken_as_it_was_typed() -> None:
    """With its spaces; but half a character is none."""
    assert fields.secret({"key": " a\n"}, "key") == " a\n"
    for value in (None, 1, "\ud800"):
        with pytest.raises(FieldInvalid, match="must be a text"):
            fields.secret({"key": value}, "key")

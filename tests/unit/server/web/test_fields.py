"""Typed getters for fields from outside."""

from __future__ import annotations

import pytest
from robotether_server.problems import FieldInvalid
from robotether_server.web import fields


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

"""What people type: taken as it is meant, or refused with the field's label."""

import pytest
from flask import Flask
from robotether_server.problems import FieldInvalidError
from robotether_server.web import forms

app = Flask("test")


def given(value, read):
    data = {} if value is None else {"x": value}
    with app.test_request_context(method="POST", data=data):
        return read()


@pytest.mark.parametrize("value", [None, "", "  "])
def test_an_empty_field_is_named(value):
    with pytest.raises(FieldInvalidError, match="fill in Name") as refused:
        given(value, lambda: forms.text("x", "Name", 63))
    assert refused.value.field == "x"
    assert given(value, lambda: forms.optional_text("x", "Name", 63)) is None
    assert given(value, lambda: forms.optional_number("x", "Port", 1, 9)) is None


@pytest.mark.parametrize("value", ["a\nb", "x" * 64, "a\u202eb"])
def test_text_that_no_column_holds_is_refused(value):
    with pytest.raises(FieldInvalidError, match="cannot use Name"):
        given(value, lambda: forms.text("x", "Name", 63))


@pytest.mark.parametrize("value", ["0", "91", "-1", "1_0", "1.5", "\u0661", "1e1", "x", "9" * 5000])
def test_what_is_no_number_is_refused(value):
    """Python would take some of these."""
    with pytest.raises(FieldInvalidError, match="Port: it must be a whole number from 1 to 90"):
        given(value, lambda: forms.number("x", "Port", 1, 90))


def test_a_choice_is_one_of_the_list():
    assert given("user", lambda: forms.choice("x", "Role", ("admin", "user"))) == "user"
    with pytest.raises(FieldInvalidError, match="choose one of admin, user"):
        given("root", lambda: forms.choice("x", "Role", ("admin", "user")))

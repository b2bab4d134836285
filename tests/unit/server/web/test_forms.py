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


@pytest.mark.parametrize("value", ["a\nb", "x" * 64, "a\u202eb"])
def test_text_that_no_column_holds_is_refused(value):
    with pytest.raises(FieldInvalidError, match="cannot use Name"):
        given(value, lambda: forms.text("x", "Name", 63))


@pytest.mark.parametrize("value", ["0", "91", "-1", "1_0", "1.5", "\u0661", "1e1", "x", "9" * 5000])
def test_what_is_no_number_is_refused(value):
    """Python would take some of these."""
    with pytest.raises(FieldInvalidError, match="Port: it must be a whole number from 1 to 90"):
        given(value, lambda: forms.number("x", "Port", 1, 90))

"""What people type: taken as it is meant, or refused with the field's label."""

import pytest
from flask import Flask
from robotether_server.problems import FieldInvalidError
from robotether_server.web import forms

app = Flask("test")


def given(value, read):
    """What is read of a form in which the field `x` has this value."""
    data = {} if value is None else {"x": value}
    with app.test_request_context(method="POST", data=data):
        return read()


def test_text_is_stripped():
    """People copy with spaces."""
    assert given(" sim1 ", lambda: forms.text("x", "Name", 63)) == "sim1"


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


@pytest.mark.parametrize("value", ["a b", "-x-", "Lift"])
def test_name_of_a_robot_fits_an_address(value):
    """The refusal says what such a name may have."""
    assert given("lift-7", lambda: forms.robot_name("x", "Name")) == "lift-7"
    with pytest.raises(FieldInvalidError, match="cannot use Name: use a-z"):
        given(value, lambda: forms.robot_name("x", "Name"))


def test_numbers_within_bounds():
    """Both bounds are included."""
    for value in ("1", "90", "07"):
        assert given(value, lambda: forms.number("x", "Port", 1, 90)) == int(value)


@pytest.mark.parametrize("value", ["0", "91", "-1", "1_0", "1.5", "\u0661", "1e1", "x", "9" * 5000])
def test_what_is_no_number_is_refused(value):
    """Python would take some of these."""
    with pytest.raises(FieldInvalidError, match="Port: it must be a whole number from 1 to 90"):
        given(value, lambda: forms.number("x", "Port", 1, 90))


def test_a_choice_is_one_of_the_list():
    """A choice outside the list is rejected."""
    assert given("user", lambda: forms.choice("x", "Role", ("admin", "user"))) == "user"
    with pytest.raises(FieldInvalidError, match="choose one of admin, user"):
        given("root", lambda: forms.choice("x", "Role", ("admin", "user")))


def test_a_box_is_ticked_or_not():
    """Browsers leave out what is not."""
    assert given("yes", lambda: forms.is_ticked("x")) is True
    assert given(None, lambda: forms.is_ticked("x")) is False


def test_a_password_is_as_typed():
    """Its spaces count."""
    assert given(" a b ", lambda: forms.secret("x")) == " a b "


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (0.5, "0.5"),
        (2.0, "2"),
        (0.12345678, "0.12345678"),
        (300, "300"),
        (["/a", "*"], "/a\n*"),
    ],
)
def test_values_are_texts_as_a_field_takes_them(value, text):
    assert forms.value_text(value) == text


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.5", 0.5), ("0,5", 0.5), ("-1", -1.0), ("1,2,3", "1,2,3"), ("1e3", "1e3"), ("", "")],
)
def test_a_setting_may_have_a_comma(text, value):
    assert forms.number_or_text(text) == value


def test_a_whole_number_has_no_comma():
    assert forms.number_or_text("2,000", whole=True) == "2,000"
    assert forms.number_or_text("2000", whole=True) == 2000


@pytest.mark.parametrize(
    ("detail", "sentence"),
    [
        (
            "cannot use x: it must be a whole number from 1 to 9",
            "Enter a whole number from 1 to 9.",
        ),
        (
            "cannot use x: it must be null or a number from 1 to 9",
            "Enter a number from 1 to 9, or leave it empty.",
        ),
        ("cannot use x: it must be one of a, b", "Choose one of a, b."),
        ("cannot use x: the name is taken", "The name is taken."),
    ],
)
def test_sentence_at_a_field_asks_for_what_is_missing(detail, sentence):
    """Its label names it."""
    assert FieldInvalidError(detail, "x").at_field == sentence

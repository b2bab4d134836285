"""What the text of a button may be."""

import pytest
from robotether_server.problems import FieldInvalidError
from robotether_server.services import drive_pages


@pytest.mark.parametrize("text", ["{", "[]", "1", "{} x", '{"a": 1, "a": 2}', "[" * 5000, "\x00"])
def test_what_is_no_json_object_is_refused(text):
    with pytest.raises(FieldInvalidError, match="cannot read what the button sends"):
        drive_pages.read(text)


def test_nothing_is_an_empty_object():
    assert drive_pages.read("") == {}
    assert drive_pages.read('{"data": true}') == {"data": True}

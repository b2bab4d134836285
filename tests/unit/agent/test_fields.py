"""Typed getters name the field that is wrong."""

import re

import pytest
from robotether_agent import fields
from robotether_agent.fields import FieldError


@pytest.mark.parametrize(
    ("get", "why"),
    [
        (lambda: fields.parse_object(b"[" * 60000, "the line"), "the line is not JSON"),
        (lambda: fields.get_int({"seq": True}, "seq", 0, 9), "field seq must be a whole number"),
        (lambda: fields.get_number({"t": float("nan")}, "t", 0, 9), "from 0 to 9, not nan"),
        (lambda: fields.get_number({"t": 10**400}, "t", 0, 9), "from 0 to 9, not 1000"),
        (lambda: fields.get_texts({"keys": ["a", 1]}, "keys"), r"field keys\[1\] must be text"),
        (lambda: fields.get_cells({"cells": {}}, "cells"), "cells must be a list of cells, not"),
        (
            lambda: fields.get_cells({"cells": [{"host": "-oA=b", "ports": [22]}]}, "cells"),
            "field host must be a host name",
        ),
        (
            lambda: fields.get_cells({"cells": [{"host": "a.example", "ports": []}]}, "cells"),
            "field ports must be a list of 1 to 8",
        ),
        (
            lambda: fields.get_match({"code": "A B"}, "code", re.compile("[a-z]+"), "a code"),
            "field code must be a code, not 'A B'",
        ),
    ],
)
def test_wrong_field_is_named(get, why):
    with pytest.raises(FieldError, match=why):
        get()


def test_of_a_long_list_of_cells_the_first_count():
    """Each that does not answer costs time, so a robot never tries dozens of them."""
    said = {"cells": [{"host": f"{at}.example", "ports": [2222, 443]} for at in range(30)]}
    cells = fields.get_cells(said, "cells")
    assert cells[:1] == (fields.ListedCell("0.example", (2222, 443)),)
    assert len(cells) == fields.MAX_CELLS


def test_text_from_outside_cannot_forge_log_lines():
    assert fields.printable("a\nERROR\x1b[31m b") == "a ERROR [31m b"
    assert len(fields.printable("x" * 10_000, 100)) == 100

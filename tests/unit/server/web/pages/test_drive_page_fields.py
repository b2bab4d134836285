"""The fields of the form for a drive page."""

from __future__ import annotations

from typing import get_args

from robotether_server.page_settings import MAY_BE_NULL, NAMES, Kind
from robotether_server.web.pages.drive_page_fields import FIELDS, KIND_WORDS


def test_every_member_of_the_page_has_a_field() -> None:
    """The three others have controls of their own kinds."""
    own = {"kind", "cameras", "hold_after_ms"}
    assert {field.name for field in FIELDS} == set(NAMES) - own
    assert tuple(kind for kind, _ in KIND_WORDS) == get_args(Kind)


def test_what_may_be_empty_says_what_that_means() -> None:
    """And nothing else may be."""
    empty = {field.name for field in FIELDS if field.empty}
    assert empty == MAY_BE_NULL - {"hold_after_ms"}

"""Names of tokens and keys."""

from __future__ import annotations

import pytest
from robotether_server.problems import FieldInvalid
from robotether_server.services.names import check_name


@pytest.mark.parametrize("name", ["a", "Ann's desk", "x" * 63, "Küche"])
def test_plain_names_pass(name: str) -> None:
    """Whatever people call their things."""
    check_name("name", name)


@pytest.mark.parametrize("name", ["", " ", "a ", "a\tb", "a\x1b[2J", "x" * 64])
def test_others_are_refused(name: str) -> None:
    """The sentence names the field."""
    with pytest.raises(FieldInvalid, match="cannot use name"):
        check_name("name", name)

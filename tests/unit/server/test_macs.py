"""MAC addresses in every usual spelling; the twin in SQL is compared in store/test_robots.py."""

from __future__ import annotations

import pytest
from robotether_server.macs import normalise
from robotether_server.problems import FieldInvalid


@pytest.mark.parametrize(
    "text", ["00:1B:44:11:3A:B7", "00-1b-44-11-3a-b7", "001b.4411.3ab7", "001B44113AB7"]
)
def test_usual_spellings_become_one(text: str) -> None:
    """Lower case with colons."""
    assert normalise(text) == "00:1b:44:11:3a:b7"


@pytest.mark.parametrize(
    "text", ["", "0:1b:44:11:3a:b7", "00:1b-44:11:3a:b7", "001b44113ab", "001b44113ab7\n", "g" * 12]
)
def test_anything_else_is_refused(text: str) -> None:
    """The sentence names the field and shows how to write it."""
    with pytest.raises(FieldInvalid, match=r"cannot use mac .* write it as 00:1b:44:11:3a:b7"):
        normalise(text)

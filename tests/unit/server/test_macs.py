"""MAC addresses in every usual spelling; the twin in SQL is compared in store/test_robots.py."""

from __future__ import annotations

import pytest
from robotether_server.macs import check_universal, normalise
from robotether_server.problems import FieldInvalid


@pytest.mark.parametrize(
    "text",
    [
        "00:1B:44:11:3A:B7",
        "00-1b-44-11-3a-b7",
        "001b.4411.3ab7",
        "001B44113AB7",
        " 00:1b:44:11:3a:b7  ",
        "0:1b:44:11:3a:b7",
        "0-1B-44-11-3A-B7",
    ],
)
def test_usual_spellings_become_one(text: str) -> None:
    """Lower case with colons, two digits a byte."""
    assert normalise(text) == "00:1b:44:11:3a:b7"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "00:1b-44:11:3a:b7",
        "001b44113ab",
        "1b.4411.3ab7",
        "00:1b:44:11:3a:",
        "00:1b:44:11:3a:1b7",
        "001b44113ab7\n",
        "\t001b44113ab7",
        "\N{FULLWIDTH DIGIT ZERO}01b44113ab7",
        "g" * 12,
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    """The sentence names the field and shows how to write it."""
    with pytest.raises(FieldInvalid, match=r"cannot use mac .* write it as 00:1b:44:11:3a:b7"):
        normalise(text)


@pytest.mark.parametrize(
    "text",
    ["00:00:00:00:00:00", "0:0:0:0:0:0", "ffff.ffff.ffff", "01:00:5e:00:00:fb", "330000000001"],
)
def test_macs_of_no_single_robot_are_refused(text: str) -> None:
    """Zero, broadcast and multicast, whatever the spelling."""
    with pytest.raises(FieldInvalid, match=r"cannot use mac .* which no single robot has"):
        normalise(text)


@pytest.mark.parametrize(
    "text", ["02:42:ac:11:00:02", "0242.ac11.0002", "2:42:ac:11:0:2", "fe0000000001"]
)
def test_macs_that_machines_give_themselves_are_refused_unless_allowed(text: str) -> None:
    """The sentence says how an admin lets one in."""
    with pytest.raises(FieldInvalid, match=r"locally administered.*--allow-local-mac"):
        normalise(text, allow_local=False)
    with pytest.raises(FieldInvalid, match="locally administered"):
        check_universal(normalise(text))


@pytest.mark.parametrize("text", ["00:1b:44:11:3a:b7", "b8:27:eb:00:00:01"])
def test_macs_of_makers_pass(text: str) -> None:
    """Those that stand on a network card."""
    assert normalise(text, allow_local=False) == text

"""Which texts are names of ROS, which of them match a pattern, and that a look never takes long."""

import itertools
import re

import pytest
from robotether_common.ros import MAX_GLOB_LENGTH, Globs, full_name, is_glob


@pytest.mark.parametrize(
    "name",
    ["", "/", "~cmd_vel", "//cmd_vel", "/cmd_vel/", "/a//b", "/cmd-vel", "/cmd_vel\n", "/\u0441md", " /a", "/a.b",
     None, 3, ["/cmd_vel"], "/" + "a" * 255, "/cmd_vel\u0000", "/\u0663"],
)  # fmt: skip
def test_any_other_spelling_is_no_name(name):
    assert full_name(name) is None


def test_full_names_and_stars_are_patterns():
    """A pattern that no name has is a mistake of who wrote it."""
    for text in ("/a", "*", "*/cmd_vel", "/a/*/b_1", "/", "/" + "a" * 255):
        assert is_glob(text)
    too_long = "/" + "a" * MAX_GLOB_LENGTH
    for text in ("", "cmd_vel", "/a b", "~/a", "/a//b", "/ä", "/a?", "/[a]", "/a\n", too_long):
        assert not is_glob(text), text


def test_it_matches_as_the_textbook_says():
    """In all short patterns a star stands for any text, slashes too, and the whole name must fit."""
    names = list(texts("/a"))
    for pattern in texts("/a*"):
        wanted = re.compile(".*".join(map(re.escape, pattern.split("*"))))
        matching = list(filter(Globs([pattern]).match, names))
        assert matching == list(filter(wanted.fullmatch, names)), pattern


def texts(letters):
    """All of up to five of these letters."""
    for length in range(6):
        yield from map("".join, itertools.product(letters, repeat=length))


def test_no_pattern_makes_a_look_long():
    """What would make a regular expression try for years is answered at once."""
    pattern = "/" + "a*" * (MAX_GLOB_LENGTH // 2 - 1) + "b"
    assert not Globs([pattern]).match("/" + "a" * 255)

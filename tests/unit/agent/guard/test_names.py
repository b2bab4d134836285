"""Names of topics and the patterns that say which drive the robot."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.names import MAX_PATTERN_LENGTH, DriveTopics, full_name

DEFAULT = DriveTopics(["/cmd_vel", "*/cmd_vel"])


@pytest.mark.parametrize("name", ["/cmd_vel", "cmd_vel", "/a/b_1/cmd_vel", "/1/x"])
def test_names_are_given_their_first_slash(name: str) -> None:
    """A relative name is read as rosbridge in the root namespace reads it."""
    full = full_name(name)
    assert full is not None
    assert full == "/" + name.lstrip("/")


@pytest.mark.parametrize(
    "name",
    ["", "/", "~cmd_vel", "//cmd_vel", "/cmd_vel/", "/a//b", "/cmd-vel", "/cmd_vel\n", "/\u0441md", " /a", "/a.b",
     None, 3, ["/cmd_vel"], "/" + "a" * 255, "/cmd_vel\u0000", "/\u0663"],
)  # fmt: skip
def test_any_other_spelling_is_no_name(name: object) -> None:
    assert full_name(name) is None


@pytest.mark.parametrize(
    ("name", "drives"),
    [("/cmd_vel", True), ("/a/cmd_vel", True), ("/a/b/cmd_vel", True), ("/cmd_vel2", False), ("/my_cmd_vel", False)],
)  # fmt: skip
def test_a_star_stands_for_any_text(name: str, *, drives: bool) -> None:
    """Slashes included, and the whole name counts."""
    assert DEFAULT.match(name) is drives


def test_a_relative_name_may_be_a_drive_topic_in_a_namespace() -> None:
    """Rosbridge in the namespace /base makes /base/vel of vel."""
    topics = DriveTopics(["/base/vel"])
    assert not topics.match("/vel")
    assert topics.might_be("vel")
    assert not topics.might_be("scan")


def test_patterns_are_names_with_stars() -> None:
    """What else stands in them would mean something to the library that matches."""
    for wrong in ("/cmd[v]el", "/cmd?vel", "", "/cmd vel"):
        with pytest.raises(ValueError, match="no name"):
            DriveTopics([wrong])
    with pytest.raises(ValueError, match="no name"):
        DriveTopics(["/" * (MAX_PATTERN_LENGTH + 1)])
    # The server takes as many; a robot that refused one would never connect.
    assert DriveTopics(["*" * MAX_PATTERN_LENGTH]).match("/cmd_vel")
    assert DEFAULT.plain() == ["/cmd_vel"]
    assert not DriveTopics([]).match("/cmd_vel")


def test_many_stars_take_no_long_time() -> None:
    """A pattern from the settings must not hold the guard up."""
    topics = DriveTopics(["*a" * 100 + "b"])
    begun = time.process_time()
    assert not topics.match("/" + "a" * 250)
    assert time.process_time() - begun < 0.5


@given(st.from_regex(r"(/[a-z_]{1,8}){0,3}/cmd_vel", fullmatch=True))
def test_every_cmd_vel_drives(name: str) -> None:
    """In whatever namespace the robot's base listens."""
    assert DEFAULT.match(name)
    assert full_name(name) == name

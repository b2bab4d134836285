"""The getters that a robot's settings go through."""

from __future__ import annotations

from functools import partial

import pytest
from robotether_server import setting_values
from robotether_server.problems import FieldInvalid
from robotether_server.setting_values import Bounds

WHOLE = partial(setting_values.whole, path="page.fps", bounds=Bounds(1, 5))
NUMBER = partial(setting_values.number, path="page.fps", bounds=Bounds(0.5, 5))
CHOICE = partial(setting_values.choice, path="page.fps", allowed=("a", "b"))
FLAG = partial(setting_values.flag, path="page.fps")
LABEL = partial(setting_values.label, path="page.fps", longest=6)
ROS_NAME = partial(setting_values.ros_name, path="page.fps")
GLOBS = partial(setting_values.globs, path="page.fps")
MEMBERS = partial(setting_values.members, path="page.fps", known=("a",))


@pytest.mark.parametrize(
    ("getter", "value", "result"),
    [
        (WHOLE, 5.0, 5),
        (NUMBER, 1, 1.0),
        (CHOICE, "b", "b"),
        (FLAG, False, False),
        (LABEL, " Dock ", "Dock"),
        (ROS_NAME, "/a/b_1", "/a/b_1"),
        (MEMBERS, {"a": None}, {"a": None}),
    ],
)
def test_what_is_meant_passes(getter, value, result):
    """A value comes back in the one way in which it is kept."""
    passed = getter(value)
    assert (passed, type(passed)) == (result, type(result))


def test_patterns_are_kept_once():
    """The same pattern twice is one."""
    assert list(GLOBS(["/a*", "/b", "/a*"])) == ["/a*", "/b"]


@pytest.mark.parametrize(
    ("getter", "value"),
    [
        *((WHOLE, value) for value in (0, 6, 1.5, "1", None, True, float("nan"), 10**400)),
        *((NUMBER, value) for value in (0.4, 5.1, "1", None, False, float("inf"))),
        *((CHOICE, value) for value in ("c", "", None, [])),
        *((FLAG, value) for value in (0, 1, "true", None)),
        *((LABEL, value) for value in ("", "   ", "a\nb", "a\u200bb", "a" * 7, 5, None)),
        *((ROS_NAME, value) for value in ("a", "/", "/a/", "//a", "/a*", "/ä", "/a\n", None)),
        (ROS_NAME, "/" + "a" * setting_values.MAX_ROS_NAME_LENGTH),
        *((GLOBS, value) for value in ("/a", ["a"], [5], None)),
        *((MEMBERS, value) for value in ([], None, {"b": 1}, {5: 1})),
    ],
)
def test_anything_else_is_refused_by_its_path(getter, value):
    """Who gave it reads which member it was."""
    with pytest.raises(FieldInvalid, match=r"cannot use page\.fps: "):
        getter(value)


def test_a_refusal_tells_what_else_is_taken():
    """Where null is a value the sentence says so."""
    with pytest.raises(FieldInvalid, match=r"must be null or a number from 0\.5 to 5"):
        NUMBER("x", instead="null or ")

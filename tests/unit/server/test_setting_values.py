"""What several members of a robot's settings hold."""

from __future__ import annotations

import pytest
from robotether_common.ros import MAX_NAME_LENGTH
from robotether_server import schemas
from robotether_server.problems import FieldInvalid
from robotether_server.setting_values import RosName, globs


def test_patterns_are_kept_once():
    """The same pattern twice is one."""
    assert list(globs(["/a*", "/b", "/a*"], "page.fps")) == ["/a*", "/b"]


@pytest.mark.parametrize("value", ["/a", ["a"], [5], None])
def test_other_patterns_are_refused_by_their_path(value):
    """Who gave it reads which member it was."""
    with pytest.raises(FieldInvalid, match=r"cannot use page\.fps: "):
        globs(value, "page.fps")


def test_full_name_passes():
    """As ROS writes it."""
    assert schemas.value("topic", "/a/b_1", RosName) == "/a/b_1"


@pytest.mark.parametrize(
    "value",
    ["a", "/", "/a/", "//a", "/a*", "/ä", "/a\n", " /a", None, "/" + "a" * MAX_NAME_LENGTH],
)
def test_other_names_are_refused(value):
    """Also one with white space around it."""
    with pytest.raises(FieldInvalid, match="cannot use topic: it must be a full name such as"):
        schemas.value("topic", value, RosName)

"""The guard's two files."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_agent.guard.motion_state import Driven, MotionFile, StopFile
from robotether_agent.problems import StateUnusable

DRIVEN = [
    Driven("/cmd_vel", "twist"),
    Driven("/base/cmd_vel", "ackermann", "ackermann_msgs/AckermannDriveStamped", "base"),
]


def test_a_stop_is_kept_with_its_name(tmp_path: Path) -> None:
    """Until it is removed; removing none is no failure."""
    file = StopFile(tmp_path)
    assert file.read() is None
    file.write("ben")
    assert StopFile(tmp_path).read() == "ben"
    file.remove()
    file.remove()
    assert file.read() is None


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"by": 3}', "\udcff"])
def test_a_stop_that_cannot_be_read_is_a_stop(tmp_path: Path, text: str) -> None:
    (tmp_path / "stop.json").write_bytes(text.encode(errors="surrogateescape"))
    assert StopFile(tmp_path).read() == ""


def test_a_stop_that_is_no_file_is_a_stop(tmp_path: Path) -> None:
    (tmp_path / "stop.json").mkdir()
    assert StopFile(tmp_path).read() == ""


def test_motion_is_kept_for_the_next_guard(tmp_path: Path) -> None:
    file = MotionFile(tmp_path)
    assert file.read() is None
    file.write(DRIVEN)
    assert MotionFile(tmp_path).read() == DRIVEN
    file.remove()
    assert file.read() is None


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", '{"topics": 3}', '{"topics": [3]}', '{"topics": [{"topic": "~x", "shape": "twist", "type": ""}]}',
        '{"topics": [{"topic": "/x", "shape": "rocket", "type": ""}]}',
        '{"topics": [{"topic": "/x", "shape": "twist", "type": "std_msgs/String"}]}',
    ],
)  # fmt: skip
def test_motion_that_cannot_be_read_is_motion(tmp_path: Path, text: str) -> None:
    (tmp_path / "motion.json").write_text(text)
    assert MotionFile(tmp_path).read() == []


def test_a_directory_that_is_gone_is_a_problem(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    with pytest.raises(StateUnusable):
        MotionFile(gone).write(DRIVEN)
    with pytest.raises(StateUnusable):
        StopFile(gone).write("ben")

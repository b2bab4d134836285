"""The mark of motion, as the drive controller keeps it."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_agent.guard.topics import REMOVED_AFTER_S, Driven, MotionFile, MotionTracker

DRIVEN = [
    Driven("/cmd_vel", "twist"),
    Driven("/base/cmd_vel", "ackermann", "ackermann_msgs/AckermannDriveStamped", "base"),
    Driven("/other/cmd_vel", "unknown"),
]
A, B = Driven("/a", "twist"), Driven("/b", "twist")


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


def test_the_motion_file_says_how_each_topic_is_driven_now(tmp_path: Path) -> None:
    """It does so after a change of type, too; of topics that were forgotten it says nothing."""
    tracker, file = MotionTracker(MotionFile(tmp_path)), MotionFile(tmp_path)
    assert tracker.ensure(A, ["/a"])
    assert tracker.ensure(B, ["/a", "/b"])
    assert file.read() == [A, B]
    stamped = Driven("/a", "twist_stamped", frame_id="base")
    assert tracker.ensure(stamped, ["/a", "/b"])
    assert file.read() == [stamped, B]
    assert tracker.ensure(A, ["/a"])
    assert file.read() == [A]
    assert tracker.ensure(B, ["/a", "/b"])
    assert file.read() == [A, B]


def test_the_motion_file_goes_when_the_robot_has_stood_for_a_while(tmp_path: Path) -> None:
    tracker, file = MotionTracker(MotionFile(tmp_path)), MotionFile(tmp_path)
    tracker.ensure(A, ["/a"])
    tracker.tend(5.0, moves=True)
    tracker.tend(5.0 + REMOVED_AFTER_S / 2, moves=False)
    assert file.read() == [A]
    assert tracker.ends_at == 5.0 + REMOVED_AFTER_S
    tracker.tend(5.0 + REMOVED_AFTER_S, moves=False)
    assert file.read() is None
    assert tracker.ends_at is None


def test_another_guards_motion_file_stays(tmp_path: Path) -> None:
    """Until it is taken over: a guard that has not read its settings yet ends while another one drives."""
    MotionTracker(MotionFile(tmp_path)).ensure(A, ["/a"])
    tracker = MotionTracker(MotionFile(tmp_path))
    tracker.end(1.0)
    assert tracker.read_previous() == [A]
    tracker.adopt([A])
    tracker.end(1.0)
    assert tracker.read_previous() is None


def test_a_motion_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    tracker = MotionTracker(MotionFile(tmp_path / "gone"))
    assert not tracker.ensure(A, ["/a"])
    (tmp_path / "gone").mkdir()
    assert tracker.ensure(A, ["/a"])
    (tmp_path / "gone" / "motion.json").unlink()
    (tmp_path / "gone" / "motion.json").mkdir()
    tracker.end(1.0)
    assert tracker.ends_at == 1.0 + REMOVED_AFTER_S

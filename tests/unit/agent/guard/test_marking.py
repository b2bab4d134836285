"""The mark of motion, as the helm keeps it."""

from __future__ import annotations

from pathlib import Path

from robotether_agent.guard.marking import MARK_KEPT_S, Marking
from robotether_agent.guard.marks import Driven, MotionFile

A, B = Driven("/a", "twist"), Driven("/b", "twist")


def test_the_mark_says_how_each_topic_is_driven_now(tmp_path: Path) -> None:
    """Also after its type changed; of topics that were forgotten it says nothing."""
    marking, file = Marking(MotionFile(tmp_path)), MotionFile(tmp_path)
    assert marking.ensure(A, ["/a"])
    assert marking.ensure(B, ["/a", "/b"])
    assert file.read() == [A, B]
    stamped = Driven("/a", "twist_stamped", frame_id="base")
    assert marking.ensure(stamped, ["/a", "/b"])
    assert file.read() == [stamped, B]
    assert marking.ensure(A, ["/a"])
    assert file.read() == [A]
    assert marking.ensure(B, ["/a", "/b"])
    assert file.read() == [A, B]


def test_the_mark_goes_when_the_robot_has_stood_for_a_while(tmp_path: Path) -> None:
    marking, file = Marking(MotionFile(tmp_path)), MotionFile(tmp_path)
    marking.ensure(A, ["/a"])
    marking.tend(5.0, moves=True)
    marking.tend(5.0 + MARK_KEPT_S / 2, moves=False)
    assert file.read() == [A]
    assert marking.ends_at == 5.0 + MARK_KEPT_S
    marking.tend(5.0 + MARK_KEPT_S, moves=False)
    assert file.read() is None
    assert marking.ends_at is None


def test_another_guards_mark_stays(tmp_path: Path) -> None:
    """Until it is taken over: a guard on the bench ends while another one drives."""
    Marking(MotionFile(tmp_path)).ensure(A, ["/a"])
    marking = Marking(MotionFile(tmp_path))
    marking.end(1.0)
    assert marking.left() == [A]
    marking.take_over([A])
    marking.end(1.0)
    assert marking.left() is None


def test_a_mark_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    """And tried again; one that cannot be removed, later."""
    marking = Marking(MotionFile(tmp_path / "gone"))
    assert not marking.ensure(A, ["/a"])
    (tmp_path / "gone").mkdir()
    assert marking.ensure(A, ["/a"])
    (tmp_path / "gone" / "motion.json").unlink()
    (tmp_path / "gone" / "motion.json").mkdir()
    marking.end(1.0)
    assert marking.ends_at == 1.0 + MARK_KEPT_S

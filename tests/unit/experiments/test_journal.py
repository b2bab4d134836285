"""Outcomes are kept whole, by scale, and never deleted."""

from __future__ import annotations

from pathlib import Path

import pytest
from paper.journal import Journal, JournalBusyError, Kept, write_json
from paper.step import Outcome, Part, Report, Scale

PART = Part(
    name="spiral",
    title="Spiral",
    steps=lambda _scale: [],
    report=lambda _scale, _results: Report(sections=()),
)
DEFAULT = Scale()


def kept(journal: Journal, value: object = 1) -> Kept:
    outcome = Outcome(values={"value": value}, took_s=1.5, load=0.5)
    return Kept(
        outcome=outcome, commit="abc", began="2026-01-02T03:04:05Z", sitting=journal.sitting
    )


def test_what_was_written_is_read_back_in_the_steps_order(tmp_path: Path) -> None:
    """Steps that have not run are not there, and those that nobody asks for are not read."""
    journal = Journal(tmp_path, DEFAULT)
    for step in ("b", "a", "gone"):
        journal.write(PART, step, kept(journal, step))
    read = Journal(tmp_path, DEFAULT).read(PART, ["a", "missing", "b"])
    assert list(read) == ["a", "b"]
    assert read["a"] == kept(journal, "a")


def test_each_scale_has_outcomes_of_its_own(tmp_path: Path) -> None:
    """A quick run between two days of a long one takes nothing from it and gives nothing to it."""
    quick, full = Journal(tmp_path, Scale(quick=True)), Journal(tmp_path, Scale(full=True))
    quick.write(PART, "a", kept(quick))
    assert full.read(PART, ["a"]) == {}
    assert Journal(tmp_path, DEFAULT).read(PART, ["a"]) == {}


def test_a_file_is_whole_or_as_it_was(tmp_path: Path) -> None:
    """What cannot be written leaves what stood there, and nothing beside it."""
    path = tmp_path / "step.json"
    write_json(path, {"value": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"value": float("inf")})
    assert path.read_text() == '{"value": 1}'
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_set_aside_is_not_read_and_not_deleted(tmp_path: Path) -> None:
    """A part that is measured anew leaves its old outcomes under `old`."""
    journal = Journal(tmp_path, DEFAULT)
    journal.set_aside(PART)
    journal.write(PART, "a", kept(journal))
    journal.set_aside(PART)
    assert journal.read(PART, ["a"]) == {}
    assert [path.name for path in (tmp_path / "default" / "old").rglob("*.json")] == ["a.json"]


def test_sittings_are_those_that_measured_what_is_kept(tmp_path: Path) -> None:
    """A process that ended before its first step is not told of."""
    idle, busy = Journal(tmp_path, DEFAULT), Journal(tmp_path, DEFAULT)
    idle.sitting, busy.sitting = "1-1", "2-2"
    idle.write_sitting({"commit": "old"})
    busy.write_sitting({"commit": "abc"})
    assert busy.sittings([kept(busy), kept(busy)]) == [{"commit": "abc"}]


def test_a_part_is_held_once(tmp_path: Path) -> None:
    """Another run is refused until the first lets go."""
    first, second = Journal(tmp_path, DEFAULT), Journal(tmp_path, DEFAULT)
    with first.held([PART]), pytest.raises(JournalBusyError, match="spiral"), second.held([PART]):
        pass
    with second.held([PART]):
        pass

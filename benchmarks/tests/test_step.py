"""Comparisons with paper and peers, and what is kept of steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from paper.page import chapter, write_page
from paper.step import Comparison, Outcome, Part, Report, ResultStore, Scale, Step
from report import table

QUICK = Scale(quick=True)
KEPT = Outcome(values={"x": 1}, began="2026-01-01T00:00:00Z")
UNMET = Comparison("success", "paper", reference=100, ours=99.9, unit="%", better="equal")


def part(name: str, *steps: str, unmet: bool = False) -> Part:
    made = [Step(name=item, title=f"step {item}", run=lambda _world: {}) for item in steps]
    return Part(
        name=name,
        title=f"A {name}",
        steps=lambda _scale: made,
        report=lambda _scale, _results: Report(comparisons=[UNMET] * unmet),
    )


@pytest.fixture
def store(tmp_path: Path) -> ResultStore:
    return ResultStore(tmp_path, QUICK)


def test_what_is_measured_anew_is_set_aside_and_the_rest_stays(store: ResultStore) -> None:
    first, other = part("one", "a", "b"), part("other", "a")
    for key in (("one", "a"), ("one", "b"), ("other", "a")):
        store.add(key, KEPT)
    before = store.path.read_text()
    store.set_aside({("one", "a"), ("one", "b")})
    assert store.outcomes(first, QUICK) == {}
    assert store.outcomes(other, QUICK) == {"a": KEPT}
    [aside] = store.path.parent.glob("quick-*.jsonl")
    assert aside.read_text() == before


def test_failed_missing_and_unmet_are_on_the_page_and_are_not_fine(
    store: ResultStore, tmp_path: Path
) -> None:
    store.add(("one", "bad"), Outcome(failure="OSError: gone", began=KEPT.began))
    store.add(("unmet", "a"), KEPT)
    store.add(("good", "a"), KEPT)
    parts = (part("one", "bad", "later"), part("unmet", "a", unmet=True), part("good", "a"))
    chapters = [chapter(each, QUICK, store) for each in parts]
    assert [each.is_fine for each in chapters] == [False, False, True]
    bad, unmet, _ = [write_page(tmp_path, each, QUICK, store).read_text() for each in chapters]
    assert "step bad: OSError: gone" in bad
    assert "0 of 2 steps succeeded, 1 failed, 1 have not run" in bad
    assert "| success | paper | 100 % | 99.9 % | 0.999 | equal | **falls short** |" in unmet


def test_a_table_has_three_digits_that_count_and_a_dash_for_what_is_missing() -> None:
    rows = [{"route": "a", "p50, ms": 1.2345, "sent": 30000}, {"route": "b", "sent": np.nan}]
    assert table(rows).splitlines() == [
        "| route | p50, ms | sent |",
        "| --- | --- | --- |",
        "| a | 1.23 | 30,000 |",
        "| b | - | - |",
    ]

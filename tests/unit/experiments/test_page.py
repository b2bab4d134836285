"""The page says what was measured, and as clearly what was not, what failed and what falls short."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from paper.journal import Journal, Kept
from paper.page import Chapter, chapter, markdown, short
from paper.page_files import write_page
from paper.step import Comparison, Data, Outcome, Part, Plot, Report, Results, Scale, Step
from sections import Section

DEFAULT = Scale()
SITTING = {
    "processor": "A <fast> one",
    "cores": 2,
    "memory_gb": 8.0,
    "kernel": "6.1",
    "versions": {"nginx": "1.26"},
    "stack": "one of its own",
}


def compared(ours: float, better: str = "lower") -> Comparison:
    return Comparison(
        what="time | start", against="paper", reference=2, ours=ours, unit="s", better=better
    )


def part(name: str = "startup", report: Report | None = None, steps: int = 2) -> Part:
    def reported(_scale: Scale, _results: Results) -> Report:
        if report is None:
            raise ZeroDivisionError("no values")
        return report

    return Part(
        name=name,
        title=f"Part {name}",
        steps=lambda _scale: [
            Step(name=f"s-{number}", title=f"repetition {number}", expected_s=1, run=lambda _: {})
            for number in range(steps)
        ],
        report=reported,
    )


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    journal = Journal(tmp_path / "journal", DEFAULT)
    journal.write_sitting(SITTING)
    return journal


def keep(journal: Journal, of: Part, outcomes: Mapping[str, Outcome], commit: str = "abc") -> None:
    for name, outcome in outcomes.items():
        journal.write(
            of,
            name,
            Kept(
                outcome=outcome,
                commit=commit,
                began="2026-01-02T03:04:05Z",
                sitting=journal.sitting,
            ),
        )


def page(journal: Journal, *chapters: Chapter) -> str:
    return markdown(chapters, DEFAULT, [SITTING], [])


GOOD = Outcome(values={"x": 1}, took_s=2.0)
EMPTY = Report(sections=())


def test_comparison_has_paper_ours_ratio_and_verdict(journal: Journal) -> None:
    """What falls short stands in the table and in the list below it."""
    one = part(report=Report(sections=(), comparisons=[compared(1), compared(3)]))
    keep(journal, one, {"s-0": GOOD, "s-1": GOOD})
    text = page(journal, chapter(one, DEFAULT, journal))
    assert r"| Part startup | time \| start | paper | 2 s | 1 s | 0.5 | lower | met |" in text
    assert "| 3 s | 1.5 | lower | **falls short** |" in text
    assert r"- time \| start is 3 s; paper has 2 s, and lower is better." in text


def test_what_is_no_number_falls_short() -> None:
    """A statistic of nothing is not good."""
    assert short(compared(float("nan")))
    assert not short(compared(1.0))


def test_failed_steps_are_counted_and_told(journal: Journal) -> None:
    """With their reasons, which are shown as they are."""
    one = part(report=EMPTY)
    keep(journal, one, {"s-0": GOOD, "s-1": Outcome(failure="OSError: <b>|x|</b>", took_s=1.0)})
    made = chapter(one, DEFAULT, journal)
    text = page(journal, made)
    assert "1 of 2 steps succeeded, 1 failed, 0 have not run; 3.0 s." in text
    assert r"- 1 failed: OSError: \<b\>\|x\|\</b\> (repetition 1)" in text
    assert "**Part startup**\n\n- 1 of 2 steps failed." in text
    assert not made.is_fine


def test_failures_of_one_kind_stand_together(journal: Journal) -> None:
    """A thousand time-outs are one line, which says that they are a thousand."""
    one = part(report=EMPTY, steps=1000)
    keep(journal, one, {f"s-{number}": Outcome(failure="TimeoutError") for number in range(1000)})
    text = page(journal, chapter(one, DEFAULT, journal))
    assert "- 1000 failed: TimeoutError (repetition 0; " in text
    assert "; and 995 more)" in text


def test_parts_that_have_not_run_are_named(journal: Journal) -> None:
    """A page of some parts does not look like one of all."""
    done, half, never = part("a", EMPTY), part("b", EMPTY), part("c", EMPTY)
    keep(journal, done, {"s-0": GOOD, "s-1": GOOD})
    keep(journal, half, {"s-0": GOOD})
    made = [chapter(one, DEFAULT, journal) for one in (done, half, never)]
    text = page(journal, *made)
    assert "- Part b: 1 of 2 steps have not run." in text
    assert "- Part c: 2 of 2 steps have not run." in text
    assert "## Part c" not in text
    assert [one.is_fine for one in made] == [True, False, False]


def test_page_of_nothing_says_so(journal: Journal) -> None:
    """A first run that has just begun has a page, too."""
    assert "Nothing has been measured yet." in page(journal, chapter(part(), DEFAULT, journal))


def test_circumstances_are_on_top(journal: Journal) -> None:
    """Steps from several commits are told, as they need not compare."""
    one = part(report=EMPTY)
    keep(journal, one, {"s-0": GOOD}, "abc")
    keep(journal, one, {"s-1": GOOD}, "def")
    text = page(journal, chapter(one, DEFAULT, journal))
    assert r"- Machine: A \<fast\> one, 2 cores, 8.0 GB of memory, Linux 6.1;" in text
    assert "- Versions: nginx 1.26." in text
    assert "abc (1 steps), def (1 steps); **steps come from several commits**" in text


def test_report_that_raises_is_a_problem_of_its_part_alone(journal: Journal) -> None:
    """The page is written, says so, and is not fine."""
    broken, good = part("a"), part("b", Report(sections=[Section("How", "Text", ["| x |"])]))
    for one in (broken, good):
        keep(journal, one, {"s-0": GOOD, "s-1": GOOD})
    made = [chapter(one, DEFAULT, journal) for one in (broken, good)]
    text = page(journal, *made)
    assert "**Part a**\n\n- its report could not be made: ZeroDivisionError: no values" in text
    assert "### How\n\nText\n\n| x |" in text
    assert [one.is_fine for one in made] == [False, True]


def test_unequal_is_not_fine_and_lower_is_no_error(journal: Journal) -> None:
    """The exit status tells of what must be met, and not of every figure that a peer has better."""
    slower = part("a", Report(sections=(), comparisons=[compared(3)]))
    unequal = part("b", Report(sections=(), comparisons=[compared(3, "equal")]))
    for one in (slower, unequal):
        keep(journal, one, {"s-0": GOOD, "s-1": GOOD})
    made = [chapter(one, DEFAULT, journal) for one in (slower, unequal)]
    assert [one.is_fine for one in made] == [True, False]


def broken_drawing(_drawing: Any) -> None:
    raise ZeroDivisionError("nothing to draw")


def test_figures_and_data_stand_beside_the_page(journal: Journal, tmp_path: Path) -> None:
    """Old ones go, ones that cannot be drawn are told, and no two have one name."""
    folder = tmp_path / "docs"
    folder.mkdir()
    (folder / "old.svg").touch()
    rows = Data(name="rows", about="what it is", header=["x"], rows=[[1]])
    one = part(
        report=Report(
            sections=(),
            plots=[
                Plot(name="curve", caption="A curve", draw=lambda drawing: drawing.subplots()),
                Plot(name="broken", caption="None", draw=broken_drawing),
            ],
            data=[rows, rows],
        )
    )
    keep(journal, one, {"s-0": GOOD, "s-1": GOOD})
    made = chapter(one, DEFAULT, journal)
    write_page(folder, [made], DEFAULT, journal)
    assert sorted(path.name for path in folder.iterdir()) == [
        "curve.svg", "index.html", "index.md", "startup-rows.csv",
    ]  # fmt: skip
    text = (folder / "index.md").read_text()
    assert "![A curve](curve.svg)" in text
    assert "[startup-rows.csv](startup-rows.csv): what it is" in text
    assert "broken.svg could not be made: ZeroDivisionError" in text
    assert "another file of the page has this name" in text
    assert not made.is_fine

"""Writes a part's page in docs/experiments/: what has failed, could not be reported or falls short is on it."""

from __future__ import annotations

import statistics
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from report import cell, duration, page, plain

from paper.step import Outcome, Part, Report, Scale

LONGEST_FAILURE = 300


@dataclass(frozen=True, kw_only=True)
class Chapter:
    part: Part
    # By the steps' names.
    outcomes: Mapping[str, Outcome]
    report: Report

    @property
    def failed(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes.values() if outcome.values is None]

    @property
    def failures(self) -> list[str]:
        return [f"{plain(step.title)}: {plain(step.failure)}" for step in self.failed]

    @property
    def shortfalls(self) -> list[str]:
        """What falls short besides the comparisons, in Markdown."""
        failed = [f"{len(self.failed)} of {len(self.outcomes)} steps failed."] * bool(self.failed)
        return [*failed, *map(plain, [*self.report.problems, *self.report.shortfalls])]

    @property
    def faults(self) -> list[str]:
        """All that makes a run fail: steps that failed, and what has to be equal and is not."""
        return [
            *(f"{step.title}: {step.failure}" for step in self.failed),
            *self.report.problems,
            *(
                f"{row.what} is {cell(row.ours)} and has to be {cell(row.reference)} {row.unit}"
                for row in self.report.comparisons
                if row.better == "equal" and row.is_short
            ),
        ]

    @property
    def took_s(self) -> float:
        return sum(outcome.took_s for outcome in self.outcomes.values())


def chapter(part: Part, outcomes: Mapping[str, Outcome]) -> Chapter:
    """Let a part report; a report that raises is a problem and not the page's end."""
    values = {name: step.values for name, step in outcomes.items() if step.values is not None}
    try:
        report = part.report(values)
    except Exception as error:  # noqa: BLE001 (the border of a part)
        traceback.print_exc()
        report = Report(problems=[f"its report could not be made: {sentence(error)}"])
    return Chapter(part=part, outcomes=outcomes, report=report)


def sentence(error: BaseException) -> str:
    """An exception in one line: its kind and what it says; of a group, those that it holds."""
    if isinstance(error, BaseExceptionGroup):  # noqa: F821 (ruff checks for 3.10; this runs from 3.11 on)
        return "; ".join(sentence(problem) for problem in error.exceptions)
    said = " ".join(str(error).split())
    if len(said) > LONGEST_FAILURE:
        said = f"{said[:LONGEST_FAILURE]}..."
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def write_page(folder: Path, item: Chapter, scale: Scale, where: Sequence[str]) -> Path:
    """Write the page; `where` says on what it was measured."""
    folder.mkdir(parents=True, exist_ok=True)
    written = folder / f"{item.part.name}.md"
    name = item.part.name if item.report.values else "experiment"
    outcomes = item.outcomes.values()
    loads, times = ([step.load for step in outcomes], [step.began for step in outcomes])
    circumstances = [
        *map(plain, where),
        f"Date: {min(times)} to {max(times)}; the {len(times)} steps took {duration(item.took_s)}.",
        f"Load when a step began: median {statistics.median(loads):.1f}, most {max(loads):.1f}.",
    ]
    values = {"one": item, "scale": scale, "circumstances": circumstances, **item.report.values}
    written.write_text(page(f"{name}.md.j2", **values))
    return written

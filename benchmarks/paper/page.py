"""Writes a part's page in docs/experiments/ from the kept outcomes.

What has not run, has failed, could not be reported or falls short is on it; nothing is left out for looking bad. The
same values give the same files, whenever and wherever they are written.
"""

from __future__ import annotations

import statistics
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from report import duration, page, plain

from paper.step import Comparison, Outcome, Part, Report, ResultStore, Scale

LONGEST_FAILURE = 300


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """What the page has of one part."""

    part: Part
    # Names and titles of all steps that belong to it.
    steps: Mapping[str, str]
    outcomes: Mapping[str, Outcome]
    report: Report
    # Why this part's report could not be made.
    problems: list[str] = field(default_factory=list)

    @property
    def failed(self) -> list[str]:
        return [name for name, outcome in self.outcomes.items() if outcome.values is None]

    @property
    def missing(self) -> list[str]:
        return [name for name in self.steps if name not in self.outcomes]

    @property
    def unmet(self) -> list[Comparison]:
        """What has to be equal, and is not."""
        return [
            comparison
            for comparison in self.report.comparisons
            if comparison.better == "equal" and comparison.is_short
        ]

    @property
    def is_fine(self) -> bool:
        """Whether all of it ran without a failure, and what has to be equal is."""
        return not (self.failed or self.missing or self.problems or self.unmet)

    @property
    def took_s(self) -> float:
        return sum(outcome.took_s for outcome in self.outcomes.values())

    @property
    def shortfalls(self) -> list[str]:
        """What falls short besides the comparisons, in Markdown."""
        failed = [f"{len(self.failed)} of {len(self.outcomes)} steps failed."] * bool(self.failed)
        return [*failed, *map(plain, [*self.problems, *self.report.shortfalls])]

    @property
    def failures(self) -> list[str]:
        """Which steps failed, and why, in Markdown."""
        return [
            f"{plain(self.steps[name])}: {plain(self.outcomes[name].failure)}"
            for name in self.failed
        ]


def chapter(part: Part, scale: Scale, store: ResultStore) -> Chapter:
    """Read a part's outcomes and let it report; a report that raises is a problem and not the page's end."""
    steps = {step.name: step.title for step in part.steps(scale)}
    outcomes = store.outcomes(part, scale)
    problems, report = [], Report()
    if outcomes:
        try:
            report = part.report(scale, outcomes)
        except Exception as error:  # noqa: BLE001 (the border of a part)
            traceback.print_exc()
            problems.append(f"its report could not be made: {sentence(error)}")
    return Chapter(part=part, steps=steps, outcomes=outcomes, report=report, problems=problems)


def sentence(error: BaseException) -> str:
    """An exception in one line: its kind and what it says; of a group, those that it holds."""
    if isinstance(error, BaseExceptionGroup):  # noqa: F821 (ruff checks for 3.10; this runs from 3.11 on)
        return "; ".join(sentence(problem) for problem in error.exceptions)
    said = " ".join(str(error).split())
    if len(said) > LONGEST_FAILURE:
        said = f"{said[:LONGEST_FAILURE]}..."
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def write_page(folder: Path, item: Chapter, scale: Scale) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    written = folder / f"{item.part.name}.md"
    name = item.part.name if item.report.values else "experiment"
    circumstances = _circumstances(list(item.outcomes.values()))
    values = {"one": item, "scale": scale, "circumstances": circumstances}
    written.write_text(page(f"{name}.md.j2", **values, **item.report.values))
    return written


def _circumstances(outcomes: Sequence[Outcome]) -> list[str]:
    loads = [step.load for step in outcomes]
    commits = Counter(step.commit for step in outcomes)
    several = "; **steps come from several commits**" if len(commits) > 1 else ""
    machines, versions = (
        " / ".join(dict.fromkeys(map(plain, texts)))
        for texts in zip(*((step.machine, step.versions) for step in outcomes), strict=True)
    )
    return [
        f"Machine: {machines}; everything runs on it.",
        f"Versions: {versions}.",
        f"Commit: {', '.join(f'{plain(name)} ({count} steps)' for name, count in commits.items())}{several}.",
        f"Date: {min(step.began for step in outcomes)} to {max(step.began for step in outcomes)}; the "
        f"{len(outcomes)} steps took {duration(sum(step.took_s for step in outcomes))}.",
        f"Load when a step began: median {statistics.median(loads):.1f}, most {max(loads):.1f}.",
    ]

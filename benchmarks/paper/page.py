"""What stands on docs/experiments/index.md, from the kept outcomes; page.md.j2 is the page.

What has not run, has failed, could not be reported or falls short is on the page;
nothing is left out for looking bad.
"""

from __future__ import annotations

import statistics
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from sections import wrapped

from paper.runner import sentence
from paper.step import Comparison, Data, Outcome, Part, Plot, Report, Scale
from paper.store import ResultStore
from paper.words import duration, number, plain

TEMPLATE = "page.md.j2"
MOST_TITLES = 5
AIMS = {
    "lower": "lower is better",
    "higher": "higher is better",
    "equal": "it has to be equal",
}


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """What the page has of one part."""

    part: Part
    # Names and titles of all steps that belong to it.
    steps: Mapping[str, str]
    outcomes: Mapping[str, Outcome]
    report: Report
    # What this part's report, figures or data could not be made for, and why.
    problems: list[str] = field(default_factory=list)

    @property
    def failed(self) -> list[str]:
        """The steps that failed."""
        return [name for name, one in self.outcomes.items() if one.values is None]

    @property
    def missing(self) -> list[str]:
        """The steps that have not run."""
        return [name for name in self.steps if name not in self.outcomes]

    @property
    def unmet(self) -> list[Comparison]:
        """What has to be equal, and is not."""
        return [one for one in self.report.comparisons if one.better == "equal" and one.is_short]

    @property
    def is_fine(self) -> bool:
        """Whether all of it ran without a failure, and what has to be equal is."""
        return not (self.failed or self.missing or self.problems or self.unmet)

    @property
    def took_s(self) -> float:
        """How long its steps took together."""
        return sum(one.took_s for one in self.outcomes.values())

    @property
    def shortfalls(self) -> list[str]:
        """What falls short, in Markdown."""
        failed = f"{len(self.failed)} of {len(self.outcomes)} steps failed."
        compared = [
            f"{plain(row.what)} is {plain(number(row.ours))} {plain(row.unit)}; {plain(row.against)} has "
            f"{plain(number(row.reference))} {plain(row.unit)}, and {AIMS[row.better]}."
            for row in self.report.comparisons
            if row.is_short
        ]
        said = [plain(line) for line in [*self.problems, *self.report.shortfalls]]
        return [*([failed] if self.failed else []), *compared, *said]

    @property
    def failures(self) -> list[str]:
        """A line a reason, in Markdown: how many steps failed for it, and which."""
        by_reason: dict[str, list[str]] = {}
        for name in self.failed:
            by_reason.setdefault(self.outcomes[name].failure, []).append(plain(self.steps[name]))
        return [
            f"{len(titles)} failed: {plain(reason)} ({'; '.join(titles[:MOST_TITLES])}"
            f"{f'; and {len(titles) - MOST_TITLES} more' if len(titles) > MOST_TITLES else ''})"
            for reason, titles in by_reason.items()
        ]


def chapter(part: Part, scale: Scale, store: ResultStore) -> Chapter:
    """Read a part's outcomes and let it report; a report that raises is a problem and not the page's end."""
    steps = {step.name: step.title for step in part.steps(scale)}
    outcomes = store.outcomes(part, scale)
    problems = []
    report = Report(sections=())
    if outcomes:
        try:
            report = part.report(scale, outcomes)
        except Exception as error:  # noqa: BLE001 (the border of a part)
            problems.append(logged(store, "its report could not be made", error))
    return Chapter(part=part, steps=steps, outcomes=outcomes, report=report, problems=problems)


def logged(store: ResultStore, what: str, error: Exception) -> str:
    """Write what was raised to the log; a line for the page."""
    with store.log.open("a") as log:
        log.write(f"{what}\n{traceback.format_exc()}\n")
    return f"{what}: {sentence(error)}"


def markdown(
    chapters: Sequence[Chapter], scale: Scale, store: ResultStore, written: Sequence[str]
) -> str:
    """The whole page; `written` are the files that stand beside it."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters |= {
        "bullets": _bullets,
        "csv_name": csv_name,
        "duration": duration,
        "number": number,
        "plain": plain,
        "svg_name": svg_name,
        "wrapped": wrapped,
    }
    outcomes = [step for one in chapters for step in one.outcomes.values()]
    return environment.get_template(TEMPLATE).render(
        chapters=chapters,
        circumstances=_circumstances(outcomes, store.sittings(outcomes)),
        comparisons=[(one, row) for one in chapters for row in one.report.comparisons],
        scale=scale,
        written=written,
    )


def svg_name(plot: Plot) -> str:
    """`spiral-fixed.svg`."""
    return f"{plot.name.replace('_', '-')}.svg"


def csv_name(part: Part, data: Data) -> str:
    """`spiral-positions.csv`: a part's files stand together."""
    prefix = part.name.replace("_", "-")
    name = data.name.replace("_", "-")
    return f"{name}.csv" if name.startswith(f"{prefix}-") else f"{prefix}-{name}.csv"


def _bullets(lines: Sequence[str]) -> str:
    return "\n".join(wrapped(f"- {line}", "  ") for line in lines)


def _circumstances(outcomes: Sequence[Outcome], sittings: Sequence[Mapping[str, Any]]) -> list[str]:
    if not outcomes:
        return []
    loads = [step.load for step in outcomes]
    commits = Counter(step.commit for step in outcomes)
    several = "; **steps come from several commits**" if len(commits) > 1 else ""
    return [
        f"Machine: {_each(sittings, _machine)}; everything runs on it.",
        f"Versions: {_each(sittings, _versions)}.",
        f"Commit: {', '.join(f'{plain(name)} ({count} steps)' for name, count in commits.items())}{several}.",
        f"Date: {min(step.began for step in outcomes)} to {max(step.began for step in outcomes)}; the "
        f"{len(outcomes)} steps took {duration(sum(step.took_s for step in outcomes))}; sittings: {len(sittings)}.",
        f"Load when a step began: median {statistics.median(loads):.1f}, most {max(loads):.1f}.",
    ]


def _each(
    sittings: Sequence[Mapping[str, Any]], describe: Callable[[Mapping[str, Any]], str]
) -> str:
    """What the sittings were told of, each that differs once."""
    return " / ".join(dict.fromkeys(map(describe, sittings)))


def _machine(sitting: Mapping[str, Any]) -> str:
    return (
        f"{plain(sitting['processor'])}, {sitting['cores']} cores, {sitting['memory_gb']} GB of memory, "
        f"Linux {plain(sitting['kernel'])}"
    )


def _versions(sitting: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{plain(name)} {plain(version)}" for name, version in sitting["versions"].items()
    )

"""Writes docs/experiments/index.md from the kept outcomes; html_page makes HTML of it.

What has not run, has failed, could not be reported or falls short is on the page;
nothing is left out for looking bad.
"""

from __future__ import annotations

import math
import statistics
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sections import wrapped

from paper import csv_files, figures
from paper.runner import checked_steps, sentence
from paper.step import Comparison, Part, Report, Results, Scale
from paper.store import ResultStore, StoredOutcome
from paper.words import duration, number, plain

HEAD = """# Experiments

The experiments of Sorrentino, Cavallo and Fiorini, "A Plug and Play Transparent Communication Layer
for Cloud Robotics Architectures" (Robotics 2020, 9, 17), and more, on the real stack.
`make experiments` writes this page. Agent, OpenSSH, relay, nginx and MariaDB are the real ones.
Robots are simulated and networks emulated. A step that fails is counted and never repeated. The
ratio is our value divided by the reference's. The paper's values are from other machines and
networks, the peers' from this same run.
"""
HOW = """Run it with `make experiments` on Debian, as root or with sudo. `QUICK=1` runs all of it small and
writes elsewhere. `FULL=1` repeats the start 1000 times, as the paper does. `ONLY=PART,...` runs
these parts alone. An interrupted run continues where it was.
"""
COMPARISONS = "| part | what | against | reference | ours | ratio | better is | verdict |"
MOST_TITLES = 5
AIMS = {
    "lower": "lower is better",
    "higher": "higher is better",
    "equal": "it has to be equal",
}
QUICK = "**A quick run**: everything once and small, to see that it works. Its figures are no measurements."


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """What the page has of one part."""

    part: Part
    # Names and titles of all steps that belong to it.
    steps: Mapping[str, str]
    stored: Mapping[str, StoredOutcome]
    report: Report
    # What this part's report, figures or data could not be made for, and why.
    problems: list[str] = field(default_factory=list)

    @property
    def failed(self) -> list[str]:
        """The steps that failed."""
        return [name for name, one in self.stored.items() if one.outcome.values is None]

    @property
    def missing(self) -> list[str]:
        """The steps that have not run."""
        return [name for name in self.steps if name not in self.stored]

    @property
    def unmet(self) -> list[Comparison]:
        """What has to be equal, and is not."""
        return [one for one in self.report.comparisons if one.better == "equal" and short(one)]

    @property
    def is_fine(self) -> bool:
        """Whether all of it ran without a failure, and what has to be equal is."""
        return not (self.failed or self.missing or self.problems or self.unmet)


def all_stored(chapters: Iterable[Chapter]) -> list[StoredOutcome]:
    """The kept outcomes of all parts."""
    return [step for one in chapters for step in one.stored.values()]


def short(comparison: Comparison) -> bool:
    """Whether ours falls short; what is no number does."""
    return not math.isfinite(comparison.ours) or comparison.falls_short


def chapter(part: Part, scale: Scale, store: ResultStore) -> Chapter:
    """Read a part's outcomes and let it report; a report that raises is a problem and not the page's end."""
    steps = {step.name: step.title for step in checked_steps(part, scale)}
    stored = store.read(part, list(steps))
    problems = []
    report = Report(sections=())
    if stored:
        results: Results = {name: one.outcome for name, one in stored.items()}
        try:
            report = part.report(scale, results)
        except Exception as error:  # noqa: BLE001 (the border of a part)
            problems.append(logged(store, "its report could not be made", error))
    return Chapter(part=part, steps=steps, stored=stored, report=report, problems=problems)


def logged(store: ResultStore, what: str, error: Exception) -> str:
    """Write what was raised to the journal's log; a line for the page."""
    with store.log.open("a") as log:
        log.write(f"{what}\n{traceback.format_exc()}\n")
    return f"{what}: {sentence(error)}"


def markdown(
    chapters: Sequence[Chapter], scale: Scale, invocations: Sequence[Mapping[str, Any]], written: Sequence[str]
) -> str:  # fmt: skip
    """The whole page; `written` are the files that stand beside it."""
    pieces = [
        HEAD,
        *([QUICK] if scale.quick else []),
        _circumstances(all_stored(chapters), invocations),
        HOW,
        "## Beside the reference",
        _comparisons(chapters),
        "## What falls short",
        *(_shortfalls(chapters) or ["Nothing that was measured."]),
        *_missing(chapters),
        *(_chapter(one, written) for one in chapters if one.stored),
    ]
    return "\n\n".join(piece.strip("\n") for piece in pieces if piece) + "\n"


def _list(lines: Sequence[str]) -> str:
    return "\n".join(wrapped(f"- {line}", "  ") for line in lines)


def _circumstances(
    stored: Sequence[StoredOutcome], invocations: Sequence[Mapping[str, Any]]
) -> str:
    if not stored:
        return "Nothing has been measured yet."
    loads = [step.outcome.load for step in stored]
    commits = Counter(step.commit for step in stored)
    several = "; **steps come from several commits**" if len(commits) > 1 else ""
    lines = [
        f"Machine: {_each(invocations, _machine)}; everything runs on it.",
        f"Versions: {_each(invocations, _versions)}.",
        f"Commit: {', '.join(f'{plain(name)} ({count} steps)' for name, count in commits.items())}{several}.",
        f"Date: {min(step.began for step in stored)} to {max(step.began for step in stored)}; the {len(stored)} "
        f"steps took {duration(sum(step.outcome.took_s for step in stored))}; sittings: {len(invocations)}.",
        f"Stack: {_each(invocations, lambda one: plain(str(one.get('stack', 'not said'))))}.",
        f"Load when a step began: median {statistics.median(loads):.1f}, most {max(loads):.1f}.",
    ]
    return _list(lines)


def _each(
    invocations: Sequence[Mapping[str, Any]], describe: Callable[[Mapping[str, Any]], str]
) -> str:
    """What the sittings were told of, each that differs once."""
    return " / ".join(dict.fromkeys(filter(None, map(describe, invocations)))) or "not kept"


def _machine(invocation: Mapping[str, Any]) -> str:
    return (
        f"{plain(invocation['processor'])}, {invocation['cores']} cores, {invocation['memory_gb']} GB of memory, "
        f"Linux {plain(invocation['kernel'])}"
    )


def _versions(invocation: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{plain(name)} {plain(version)}"
        for name, version in invocation.get("versions", {}).items()
    )


def _comparisons(chapters: Sequence[Chapter]) -> str:
    rows = [_comparison(one, row) for one in chapters for row in one.report.comparisons]
    if not rows:
        return "Nothing that compares has been measured yet."
    return "\n".join([COMPARISONS, "|---" * COMPARISONS.count(" | ") + "|---|", *rows])


def _comparison(one: Chapter, row: Comparison) -> str:
    ratio = "-" if row.ratio is None else number(row.ratio)
    verdict = "**falls short**" if short(row) else "met"
    cells = [
        one.part.title,
        row.what,
        row.against,
        f"{number(row.reference)} {row.unit}",
        f"{number(row.ours)} {row.unit}",
        ratio,
        row.better,
    ]
    return f"| {' | '.join(plain(cell) for cell in cells)} | {verdict} |"


def _shortfalls(chapters: Sequence[Chapter]) -> list[str]:
    """A heading and a list for each part that something falls short in."""
    lists = [(one.part.title, _short_lines(one)) for one in chapters]
    return [f"**{plain(title)}**\n\n{_list(lines)}" for title, lines in lists if lines]


def _short_lines(one: Chapter) -> list[str]:
    failed = f"{len(one.failed)} of {len(one.stored)} steps failed."
    compared = [
        f"{plain(row.what)} is {plain(number(row.ours))} {plain(row.unit)}; {plain(row.against)} has "
        f"{plain(number(row.reference))} {plain(row.unit)}, and {AIMS[row.better]}."
        for row in one.report.comparisons
        if short(row)
    ]
    said = [plain(line) for line in [*one.problems, *one.report.shortfalls]]
    return [*([failed] if one.failed else []), *compared, *said]


def _missing(chapters: Sequence[Chapter]) -> list[str]:
    lines = [
        f"{plain(one.part.title)}: {len(one.missing)} of {len(one.steps)} steps have not run."
        for one in chapters
        if one.missing
    ]
    return ["## Not measured", _list(lines)] if lines else []


def _chapter(one: Chapter, written: Sequence[str]) -> str:
    took_s = sum(step.outcome.took_s for step in one.stored.values())
    text = [
        f"## {plain(one.part.title)}",
        f"{len(one.stored) - len(one.failed)} of {len(one.steps)} steps succeeded, {len(one.failed)} failed, "
        f"{len(one.missing)} have not run; {duration(took_s)}.",
        _list(_failures(one)),
    ]
    for section in one.report.sections:
        text += [f"### {section.title}", wrapped(section.text), "\n".join(section.table)]
    for plot in one.report.plots:
        if (name := figures.file_name(plot)) in written:
            text += [f"![{plain(plot.caption)}]({name})", wrapped(f"*{plain(plot.caption)}*")]
    links = [
        f"[{name}]({name}): {plain(data.about)}"
        for data in one.report.data
        if (name := csv_files.file_name(one.part.name, data)) in written
    ]
    text += ["Data:" if links else "", _list(links)]
    return "\n\n".join(piece.strip("\n") for piece in text if piece)


def _failures(one: Chapter) -> list[str]:
    """A line a reason: how many steps failed for it, and which."""
    by_reason: dict[str, list[str]] = {}
    for name in one.failed:
        by_reason.setdefault(one.stored[name].outcome.failure, []).append(plain(one.steps[name]))
    return [
        f"{len(titles)} failed: {plain(reason)} ({'; '.join(titles[:MOST_TITLES])}"
        f"{f'; and {len(titles) - MOST_TITLES} more' if len(titles) > MOST_TITLES else ''})"
        for reason, titles in by_reason.items()
    ]

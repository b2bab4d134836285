"""Writes a part's page in docs/experiments/ from the kept outcomes, with figures (SVG) and raw data (CSV) beside it.

page.md.j2 is the page. What has not run, has failed, could not be reported or falls short is on it; nothing is left
out for looking bad. The same values give the same files, whenever and wherever they are written.
"""

from __future__ import annotations

import csv
import statistics
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from sections import bullets, duration, number, plain, wrapped

from paper.step import Comparison, Data, Outcome, Part, Plot, Report, ResultStore, Scale

TEMPLATE = "page.md.j2"
MOST_TITLES, LONGEST_FAILURE = 5, 300
SIZE_INCHES = (8.0, 4.5)
# White behind everything, for pages that are dark; ids that do not differ from one drawing to the next.
STYLE = {
    "svg.hashsalt": "robotether",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 10,
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
        return [name for name, one in self.outcomes.items() if one.values is None]

    @property
    def missing(self) -> list[str]:
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
        return sum(one.took_s for one in self.outcomes.values())

    @property
    def shortfalls(self) -> list[str]:
        """What falls short besides the comparisons, in Markdown."""
        failed = [f"{len(self.failed)} of {len(self.outcomes)} steps failed."] * bool(self.failed)
        return [*failed, *map(plain, [*self.problems, *self.report.shortfalls])]

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

    def files(self) -> Iterator[tuple[str, Callable[[Path], None]]]:
        """The names of its figures and data, and what writes each."""
        for plot in self.report.plots:
            yield f"{plot.name}.svg", partial(_draw, plot)
        for data in self.report.data:
            yield f"{data.name}.csv", partial(_write_csv, data)


def chapter(part: Part, scale: Scale, store: ResultStore) -> Chapter:
    """Read a part's outcomes and let it report; a report that raises is a problem and not the page's end."""
    steps = {step.name: step.title for step in part.steps(scale)}
    outcomes = store.outcomes(part, scale)
    problems, report = [], Report(sections=())
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
        return "; ".join(sentence(one) for one in error.exceptions)
    said = " ".join(str(error).split())
    if len(said) > LONGEST_FAILURE:
        said = f"{said[:LONGEST_FAILURE]}..."
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def write_page(folder: Path, one: Chapter, scale: Scale, store: ResultStore) -> Path:
    """Write a part's page, figures and data; its files of an earlier page that this one has not are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    written = {name for name, write in one.files() if _try(one, folder / name, write)}
    page = folder / f"{one.part.name}.md"
    page.write_text(markdown(one, scale, store, written))
    for old in folder.glob(f"{one.part.name}-*"):
        if old.name not in written:
            old.unlink()
    return page


def _try(one: Chapter, path: Path, write: Callable[[Path], None]) -> bool:
    """Write a file; one that cannot be made is a problem of its chapter."""
    try:
        write(path)
    except Exception as error:  # noqa: BLE001 (the border of a part's own drawing)
        traceback.print_exc()
        one.problems.append(f"{path.name} could not be made: {sentence(error)}")
        return False
    return True


def markdown(one: Chapter, scale: Scale, store: ResultStore, written: set[str]) -> str:
    """The whole page; `written` are the files that stand beside it."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    filters = (bullets, duration, number, plain, wrapped)
    environment.filters |= {each.__name__: each for each in filters}
    outcomes = list(one.outcomes.values())
    return environment.get_template(TEMPLATE).render(
        one=one,
        circumstances=_circumstances(outcomes, store.sittings(outcomes)),
        scale=scale,
        written=written,
    )


def _draw(plot: Plot, path: Path) -> None:
    """Draw a figure, whose size it may change itself."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=SIZE_INCHES, layout="constrained")
        plot.draw(drawing)
        canvas = FigureCanvasSVG(drawing)
        canvas.print_svg(path, metadata={"Date": None, "Creator": None})


def _write_csv(data: Data, path: Path) -> None:
    with path.open("w", newline="") as file:
        file.write(f"# {' '.join(data.about.split())}\n")
        csv.writer(file, lineterminator="\n").writerows([data.header, *data.rows])


def _circumstances(outcomes: Sequence[Outcome], sittings: Sequence[Mapping[str, Any]]) -> list[str]:
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

"""Writes docs/experiments/: the page, and its figures (SVG) and raw data (CSV) beside it.

The same values give the same files, whenever and wherever they are written. Data that would be larger than LARGEST is
folded: decimals are rounded and equal rows counted, as every message's latency is too much to keep with the sources,
and the distribution is what a reader needs.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from paper.page import Chapter, csv_name, logged, markdown, svg_name
from paper.step import Data, Plot, Scale
from paper.store import ResultStore

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
LARGEST = 300_000
DECIMALS = 2
FOLDED = f"; one row for all that are equal when rounded to {DECIMALS} decimals, and their count"


def write_page(folder: Path, chapters: Sequence[Chapter], scale: Scale, store: ResultStore) -> Path:
    """Write page, figures and data; files of an earlier page that this one has not are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    written: list[str] = []
    for one in chapters:
        for name, make in _files(one):
            if name in written:
                one.problems.append(
                    f"{name} was not written: another file of the page has this name"
                )
                continue
            try:
                make(folder / name)
                written.append(name)
            except Exception as error:  # noqa: BLE001 (the border of a part's own drawing)
                one.problems.append(logged(store, f"{name} could not be made", error))
    page = folder / "index.md"
    page.write_text(markdown(chapters, scale, store, written))
    for old in [*folder.glob("*.svg"), *folder.glob("*.csv")]:
        if old.name not in written:
            old.unlink()
    return page


def _files(one: Chapter) -> Iterator[tuple[str, Callable[[Path], None]]]:
    """The names of a part's figures and data, and what writes each."""
    for plot in one.report.plots:
        yield svg_name(plot), partial(_draw, plot)
    for data in one.report.data:
        yield csv_name(one.part, data), partial(_write_csv, data)


def _draw(plot: Plot, path: Path) -> None:
    """Draw a figure, whose size it may change itself."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=SIZE_INCHES, layout="constrained")
        plot.draw(drawing)
        canvas = FigureCanvasSVG(drawing)
        canvas.print_svg(path, metadata={"Date": None, "Creator": None})


def _write_csv(data: Data, path: Path) -> None:
    path.write_text(csv_text(data))


def csv_text(data: Data) -> str:
    """The file: what it is behind a #, the header, the rows."""
    whole = _text(data.about, data.header, data.rows)
    if len(whole.encode()) <= LARGEST:
        return whole
    counts = Counter(tuple(_rounded(value) for value in row) for row in data.rows)
    rows = [(*row, count) for row, count in counts.items()]
    return _text(data.about + FOLDED, (*data.header, "count"), rows)


def _rounded(value: object) -> object:
    return round(value, DECIMALS) if isinstance(value, float) else value


def _text(about: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    file = io.StringIO()
    file.write(f"# {' '.join(about.split())}\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return file.getvalue()

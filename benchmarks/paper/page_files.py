"""Writes docs/experiments/: the page as Markdown and HTML, and figures and data beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from paper import csv_files, figures
from paper.html_page import render
from paper.page import Chapter, all_stored, logged, markdown
from paper.step import Scale
from paper.store import ResultStore

# Writes one file.
Maker = Callable[[], Path]


def write_page(folder: Path, chapters: Sequence[Chapter], scale: Scale, store: ResultStore) -> None:
    """Write page, figures and data; files of an earlier page that this one has not are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    written = _write_files(folder, chapters, store)
    text = markdown(chapters, scale, store.invocations(all_stored(chapters)), written)
    (folder / "index.md").write_text(text)
    (folder / "index.html").write_text(render(text))
    for old in [*folder.glob("*.svg"), *folder.glob("*.csv")]:
        if old.name not in written:
            old.unlink()


def _write_files(folder: Path, chapters: Sequence[Chapter], store: ResultStore) -> list[str]:
    """Names of figures and data that could be written; what could not is its chapter's problem."""
    written: list[str] = []
    for one in chapters:
        for name, make in _makers(folder, one):
            if name in written:
                one.problems.append(
                    f"{name} was not written: another file of the page has this name"
                )
            elif problem := _made(make, name, store):
                one.problems.append(problem)
            else:
                written.append(name)
    return written


def _makers(folder: Path, one: Chapter) -> Iterator[tuple[str, Maker]]:
    for plot in one.report.plots:
        yield figures.file_name(plot), partial(figures.write, folder, plot)
    for data in one.report.data:
        yield (
            csv_files.file_name(one.part.name, data),
            partial(csv_files.write, folder, one.part.name, data),
        )


def _made(make: Maker, name: str, store: ResultStore) -> str:
    """Why the file could not be made; empty when it was."""
    try:
        make()
    except Exception as error:  # noqa: BLE001 (the border of a part's own drawing)
        return logged(store, f"{name} could not be made", error)
    return ""

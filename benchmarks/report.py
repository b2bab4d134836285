"""Turns rows of results into tables and pages, for `make bench` and `make experiments`.

Tables are pandas', pages are the Jinja templates in templates/. An experiment gives its rows and the values that its
template names; none writes Markdown itself.
"""

from __future__ import annotations

import math
import os
import platform
import re
import subprocess
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from demo import ROOT
from jinja2 import Environment, FileSystemLoader, StrictUndefined

NONE = "-"
MINUTE_S, HOUR_S = 60, 3600
# Characters that have a meaning in Markdown or HTML; a backslash before one takes it away.
_SIGNS = re.compile(r"([\\`*_{}\[\]<>()#|~&!])")
# Each run writes these pages again, which does not change the sources.
OUR_OWN_PAGES = (":(exclude)docs/experiments", ":(exclude)docs/measurements.md")
Row = Mapping[str, object]


@dataclass(frozen=True)
class Section:
    title: str
    text: str
    rows: Sequence[Row] = ()

    @property
    def markdown(self) -> str:
        return f"## {self.title}\n\n{wrapped(self.text)}\n\n{table(self.rows)}\n"


def table(rows: Iterable[Row] | pd.DataFrame) -> str:
    """The rows in Markdown, with the members' names as columns; a dash for what a row has not got."""
    whole = rows if isinstance(rows, pd.DataFrame) else list(rows)
    cells = pd.DataFrame(whole, dtype=object).map(cell)
    lines = [cells.columns, ["---"] * cells.columns.size, *cells.itertuples(index=False)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cell(value: str | float | None) -> str:
    """A whole number in full, any other one with three digits that count; a text stays as it is."""
    if isinstance(value, str):
        return value
    if value is None or math.isnan(value):
        return NONE
    if value == int(value) or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def quantiles(
    values: Iterable[float | None], *parts: float, unit: str = "s"
) -> Mapping[str, float]:
    """Columns such as "p50, s", and "max, s" for 1; what did not happen (None) is in none of them."""
    known = pd.Series(list(values), dtype=float).dropna()
    names = ("max" if part == 1 else f"p{100 * part:g}" for part in parts)
    return {
        f"{name}, {unit}": known.quantile(part) for name, part in zip(names, parts, strict=True)
    }


def wrapped(text: str, indent: str = "") -> str:
    """The text in lines of at most 100 characters, all but the first indented; an empty line divides its paragraphs."""
    fill = textwrap.TextWrapper(
        100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    ).fill
    return "\n\n".join(map(fill, re.split(r"\n\s*\n", text.strip())))


def plain(text: str) -> str:
    """The text in one line, so that nothing in it is taken for Markdown or HTML; also good in a table."""
    return _SIGNS.sub(r"\\\1", " ".join(text.split()))


def duration(seconds: float) -> str:
    if seconds < MINUTE_S:
        return f"{seconds:.1f} s"
    if seconds < HOUR_S:
        return f"{int(seconds // MINUTE_S)} min {int(seconds % MINUTE_S)} s"
    return f"{int(seconds // HOUR_S)} h {int(seconds % HOUR_S // MINUTE_S)} min"


def bullets(lines: Iterable[str]) -> str:
    return "\n".join(wrapped(f"- {line}", "  ") for line in lines)


def page(template: str, **values: Any) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    filters = (bullets, cell, duration, plain, table, wrapped)
    environment.filters |= {each.__name__: each for each in filters}
    return environment.get_template(template).render(values)


def machine() -> dict[str, Any]:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    memory_bytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "processor": models[0] if models else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gb": round(memory_bytes / 1e9, 1),
        "kernel": platform.release().split("-")[0],
    }


def commit() -> str:
    """What `git describe` calls the sources; `unknown` without git or its folder."""
    try:
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", *OUR_OWN_PAGES)
        return _git("describe", "--always") + ("-dirty" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()

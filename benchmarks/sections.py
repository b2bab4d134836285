"""A section of a page of measurements, how the pages write numbers, and on what machine something was measured.

Used by `make bench` and `make experiments`. Percentiles are numpy's.
"""

from __future__ import annotations

import math
import os
import platform
import re
import subprocess
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from demo import ROOT

NONE = "-"
MINUTE_S, HOUR_S = 60, 3600
# What means something in Markdown or HTML; a backslash before it makes it mean itself.
_SIGNS = re.compile(r"([\\`*_{}\[\]<>()#|~&!])")
# Each run writes them anew, which makes the sources no other ones.
OUR_OWN_PAGES = ":(exclude)docs/experiments"


@dataclass(frozen=True)
class Section:
    """A heading, what was measured and aimed at, and a table whose columns are divided by |."""

    title: str
    text: str
    columns: str = ""
    rows: Sequence[Sequence[object]] = ()

    @property
    def table(self) -> str:
        """In Markdown; empty without columns."""
        if not self.columns:
            return ""
        rule = "|" + "---|" * len(self.columns.split("|"))
        rows = (f"| {' | '.join(map(str, row))} |" for row in self.rows)
        return "\n".join([f"| {self.columns} |", rule, *rows])

    @property
    def markdown(self) -> str:
        return f"## {self.title}\n\n{wrapped(self.text)}\n\n{self.table}\n"


def wrapped(text: str, indent: str = "") -> str:
    """The text in lines of at most 100 characters, all but the first indented; an empty line divides its paragraphs."""
    fill = textwrap.TextWrapper(
        100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    ).fill
    return "\n\n".join(map(fill, text.split("\n\n")))


def plain(text: str) -> str:
    """The text in one line, so that nothing in it is taken for Markdown or HTML; also good in a table."""
    return _SIGNS.sub(r"\\\1", " ".join(text.split()))


def number(value: float) -> str:
    """Four digits that count; whole numbers and large ones in full, with commas between thousands."""
    if not math.isfinite(value):
        return str(value)
    if value == int(value) or abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.4g}"


def fixed(value: float | None, digits: int) -> str:
    """The number with so many decimals; a dash for what was not measured."""
    return NONE if value is None else f"{value:.{digits}f}"


def duration(seconds: float) -> str:
    """`12.3 s`, `4 min 10 s` or `1 h 2 min`."""
    if seconds < MINUTE_S:
        return f"{seconds:.1f} s"
    if seconds < HOUR_S:
        return f"{int(seconds // MINUTE_S)} min {int(seconds % MINUTE_S)} s"
    return f"{int(seconds // HOUR_S)} h {int(seconds % HOUR_S // MINUTE_S)} min"


def bullets(lines: Iterable[str]) -> str:
    return "\n".join(wrapped(f"- {line}", "  ") for line in lines)


def machine() -> dict[str, Any]:
    """Processor, cores, memory (GB) and kernel of this machine."""
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
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", OUR_OWN_PAGES)
        return _git("describe", "--always") + ("-dirty" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()

"""A section of docs/measurements.md, and the statistics that all measurements use.

Each experiment that `make bench` runs returns a `Section`; `bench` writes them one after the other.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Section:
    """A heading, what was measured and aimed at, and a Markdown table, one text a line."""

    title: str
    text: str
    table: Sequence[str]

    @property
    def markdown(self) -> str:
        """The section as it stands in the page."""
        return f"## {self.title}\n\n{wrapped(self.text)}\n\n" + "\n".join(self.table) + "\n"


def wrapped(text: str, indent: str = "") -> str:
    """The text in lines of at most 100 characters, all but the first indented; an empty line divides its paragraphs."""
    return "\n\n".join(
        textwrap.fill(
            paragraph,
            100,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        for paragraph in text.split("\n\n")
    )


def quantile(values: Sequence[float], part: float) -> float:
    """The value that `part` (0 to 1) of them stay below or reach; linear between neighbours."""
    ordered = sorted(values)
    position = part * (len(ordered) - 1)
    low = int(position)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (position - low)

"""Raw data beside the page, as CSV.

What would be larger than LARGEST is folded: decimals are rounded and equal rows counted, as every message's latency is
too much to keep with the sources, and the distribution is what a reader needs.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from paper.step import Data

LARGEST = 300_000
DECIMALS = 2
FOLDED = f"; one row for all that are equal when rounded to {DECIMALS} decimals, and their count"


def file_name(part: str, data: Data) -> str:
    """`spiral-positions.csv`: a part's files stand together."""
    prefix = part.replace("_", "-")
    name = data.name.replace("_", "-")
    return f"{name}.csv" if name.startswith(f"{prefix}-") else f"{prefix}-{name}.csv"


def text(data: Data) -> str:
    """The file: what it is behind a #, the header, the rows."""
    whole = _text(data.about, data.header, data.rows)
    if len(whole.encode()) <= LARGEST:
        return whole
    counts = Counter(tuple(_rounded(value) for value in row) for row in data.rows)
    rows = [(*row, count) for row, count in counts.items()]
    return _text(data.about + FOLDED, (*data.header, "count"), rows)


def write(folder: Path, part: str, data: Data) -> Path:
    """Write the file and return where it is."""
    path = folder / file_name(part, data)
    path.write_text(text(data))
    return path


def _rounded(value: object) -> object:
    return round(value, DECIMALS) if isinstance(value, float) else value


def _text(about: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    file = io.StringIO()
    file.write(f"# {' '.join(about.split())}\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return file.getvalue()

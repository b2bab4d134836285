"""CSV files say what they are, and stay small."""

from __future__ import annotations

import csv

from paper.page_files import LARGEST, csv_text
from paper.step import Data


def data(rows: list[tuple[object, ...]], name: str = "latency") -> Data:
    return Data(name=name, about="one-way latency in ms", header=["pair", "ms"], rows=rows)


def test_large_file_has_counts_in_place_of_messages() -> None:
    """Each message is still counted, and the first line says how."""
    rows = [(1, 0.5 + index % 100 / 1000) for index in range(100_000)]
    written = csv_text(data(list(rows)))
    assert len(written) < LARGEST
    first, *lines = written.splitlines()
    assert "rounded to 2 decimals" in first
    folded = list(csv.DictReader(lines))
    assert sum(int(row["count"]) for row in folded) == len(rows)
    assert {row["ms"] for row in folded} == {
        f"{0.5 + step / 100:.2f}".rstrip("0") for step in range(11)
    }

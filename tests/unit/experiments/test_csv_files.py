"""CSV files say what they are, and stay small."""

from __future__ import annotations

import csv
from pathlib import Path

from paper.csv_files import LARGEST, file_name, text, write
from paper.step import Data


def data(rows: list[tuple[object, ...]], name: str = "latency") -> Data:
    return Data(name=name, about="one-way latency in ms", header=["pair", "ms"], rows=rows)


def test_file_has_what_it_is_the_header_and_the_rows(tmp_path: Path) -> None:
    """Signs of CSV within values are quoted."""
    path = write(tmp_path, "high_rate", data([(1, 0.123456), ("a,b", None)]))
    assert path.name == "high-rate-latency.csv"
    assert path.read_text() == '# one-way latency in ms\npair,ms\n1,0.123456\n"a,b",\n'


def test_name_begins_with_its_part_once() -> None:
    """Whatever the part has called it."""
    assert file_name("spiral", data([], "spiral-ends")) == "spiral-ends.csv"
    assert file_name("spiral", data([], "ends")) == "spiral-ends.csv"


def test_large_file_has_counts_in_place_of_messages() -> None:
    """Each message is still counted, and the first line says how."""
    rows = [(1, 0.5 + index % 100 / 1000) for index in range(100_000)]
    written = text(data(list(rows)))
    assert len(written) < LARGEST
    first, *lines = written.splitlines()
    assert "rounded to 2 decimals" in first
    folded = list(csv.DictReader(lines))
    assert sum(int(row["count"]) for row in folded) == len(rows)
    assert {row["ms"] for row in folded} == {
        f"{0.5 + step / 100:.2f}".rstrip("0") for step in range(11)
    }

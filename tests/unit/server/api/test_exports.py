"""Records as files, which may be long and hold what strangers chose."""

import csv
import io
import json
from types import SimpleNamespace

import pytest
from robotether_server.api import exports

COLUMNS = ("id", "actor", "details")
PIECE = exports.PIECE


@pytest.mark.parametrize(
    ("total", "limit"),
    [
        *((total, None) for total in (0, 1, PIECE, PIECE + 1)),
        *((10_000, limit) for limit in (1, PIECE, PIECE + 3)),
    ],
)
def test_everything_up_to_the_limit_comes_piece_by_piece(total, limit):
    read = []

    def fetch(before, wanted):
        assert wanted <= PIECE
        start = total if before is None else before - 1
        piece = range(start, max(start - wanted, 0), -1)
        read.extend(piece)
        return [SimpleNamespace(id=number) for number in piece]

    found = [item.id for item in exports.everything(fetch, limit)]
    assert found == read == list(range(total, total - min(total, limit or total), -1))


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1", "\n=1"])
def test_csv_has_no_cell_that_a_spreadsheet_runs(text):
    """An apostrophe makes it a text; quotes and commas are no way around it."""
    records = [{"id": -5, "actor": text + '",=2', "details": {"a": text}}]
    answer = exports.answer(records, COLUMNS, "csv", "x")
    head, row = csv.reader(io.StringIO(answer.get_data(as_text=True), newline=""))
    assert tuple(head) == COLUMNS
    assert row == ["-5", "'" + text + '",=2', json.dumps({"a": text})]

"""Records as files, which may be long and hold what strangers chose."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass

import pytest
from robotether_server.api import exports

COLUMNS = ("id", "actor", "details")


@dataclass(frozen=True)
class Numbered:
    id: int


def fetched(total, asked):
    """All records that come of `total`, in pieces whose sizes are written down."""

    def fetch(before, wanted):
        asked.append(wanted)
        start = total if before is None else before - 1
        return [Numbered(number) for number in range(start, max(start - wanted, 0), -1)]

    return list(exports.everything(fetch, None))


@pytest.mark.parametrize("total", [0, 1, exports.PIECE, exports.PIECE + 1])
def test_everything_comes_piece_by_piece(total):
    asked = []
    assert [item.id for item in fetched(total, asked)] == list(range(total, 0, -1))
    assert set(asked) == {exports.PIECE}


@pytest.mark.parametrize("limit", [1, exports.PIECE, exports.PIECE + 3])
def test_limit_is_kept(limit):
    read = []

    def fetch(before, wanted):
        found = [Numbered((before or 10_000) - number - 1) for number in range(wanted)]
        read.extend(item.id for item in found)
        return found

    assert len(list(exports.everything(fetch, limit))) == len(read) == limit


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1", "\n=1"])
def test_csv_has_no_cell_that_a_spreadsheet_runs(text):
    """An apostrophe makes it a text; quotes and commas are no way around it."""
    records = [{"id": -5, "actor": text + '",=2', "details": {"a": text}}]
    answer = exports.answer(records, COLUMNS, "csv", "x")
    head, row = csv.reader(io.StringIO(answer.get_data(as_text=True), newline=""))
    assert tuple(head) == COLUMNS
    assert row == ["-5", "'" + text + '",=2', json.dumps({"a": text})]


def test_json_has_an_object_a_line():
    records = [{"id": 2, "actor": "=ü\n"}, {"id": 1, "actor": None}]
    answer = exports.answer(iter(records), COLUMNS, "jsonl", "x")
    assert [json.loads(line) for line in answer.get_data(as_text=True).splitlines()] == records
    assert answer.headers["Content-Disposition"] == 'attachment; filename="x.jsonl"'


def test_empty_file_has_its_heads():
    """CSV says what there would be; JSON lines are none."""
    assert exports.answer([], COLUMNS, "csv", "x").get_data(as_text=True) == "id,actor,details\r\n"
    assert exports.answer([], COLUMNS, "jsonl", "x").get_data(as_text=True) == ""


def test_failure_at_the_first_record_is_no_file():
    """It is told before anything was sent."""

    def fail(_before, _wanted):
        raise LookupError

    with pytest.raises(LookupError):
        exports.answer(
            ({"id": item.id} for item in exports.everything(fail, None)), COLUMNS, "csv", "x"
        )

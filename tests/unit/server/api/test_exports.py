"""Records as files, which may be long and hold what strangers chose."""

import csv
import io
import json
from types import SimpleNamespace

import pytest
from drive_records import add_drive
from robotether_server.api import exports
from robotether_server.db import credentials
from robotether_server.problems import TokenInvalidError

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


@pytest.mark.parametrize("path", ["/audit", "/drives"])
def test_a_file_ends_with_the_right_to_it(root, database, admin_database, monkeypatch, path):
    """Who reads slowly gets no more of it."""
    for fence in range(3):
        add_drive(admin_database, "sim1", "root", fence=fence)
        root.ask("PATCH", "/robots/sim1", {"shell": fence % 2 == 0})
    monkeypatch.setattr(exports, "PIECE", 1)
    lines = root.ask("GET", f"{path}?format=jsonl").iter_encoded()
    assert json.loads(next(lines))["id"]
    with database.transaction() as tx:
        [token] = credentials.list_tokens(tx)
        credentials.delete_token(tx, token.id)
    with pytest.raises(TokenInvalidError):
        list(lines)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1", "\n=1"])
def test_csv_has_no_cell_that_a_spreadsheet_runs(text):
    """An apostrophe makes it a text; quotes and commas are no way around it."""
    records = [{"id": -5, "actor": text + '",=2', "details": {"a": text}}]
    answer = exports.answer(records, COLUMNS, "csv", "x")
    head, row = csv.reader(io.StringIO(answer.get_data(as_text=True), newline=""))
    assert tuple(head) == COLUMNS
    assert row == ["-5", "'" + text + '",=2', json.dumps({"a": text})]

"""What a page is asked to look for."""

import datetime as dt
from types import SimpleNamespace

import pytest
from flask import Flask
from robotether_server.problems import FieldInvalidError
from robotether_server.web import filters

NAMES = ("robot", "since", "until")


def asked(query):
    with Flask("x").test_request_context(f"/?{query}"):
        return filters.query_of(NAMES)


def test_days_are_whole():
    found = asked("robot=+sim1&since=2026-01-30&until=2026-01-31&other=1")
    assert found == {"robot": "sim1", "since": "2026-01-30", "until": "2026-01-31"}
    assert filters.since(found) == dt.datetime(2026, 1, 30, tzinfo=dt.UTC)
    assert filters.until(found) == dt.datetime(2026, 2, 1, tzinfo=dt.UTC)


def test_moments_are_taken_as_they_are():
    """Timestamps are taken unchanged, and an empty query asks for nothing."""
    noon = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)
    found = asked("until=2026-01-31T12:00:00Z")
    assert (filters.since(found), filters.until(found)) == (None, noon)
    assert filters.until(asked("")) is None


@pytest.mark.parametrize("text", ["x", "2026-02-30", "9999-12-31"])
def test_what_is_no_day_is_refused(text):
    """The last day that a computer knows has none after it."""
    with pytest.raises(FieldInvalidError, match="cannot use To"):
        filters.until(asked(f"until={text}"))


def test_link_asks_for_the_same():
    """A link keeps and adds to the query; an empty query stays empty."""
    assert filters.link("/x", asked("robot=a%26b"), before=5) == "/x?robot=a%26b&before=5"
    assert filters.link("/x", asked("")) == "/x"


def test_a_page_leads_to_the_others():
    """To what is older if there is any, and back to the newest if it is not shown."""
    found = [SimpleNamespace(id=number) for number in range(filters.ROWS_TO_READ, 0, -1)]
    with Flask("x").test_request_context("/?before=99"):
        page = filters.page("/x", {}, found)
    assert (page.rows, page.older, page.newest) == (found[:-1], "/x?before=2", "/x")
    with Flask("x").test_request_context("/?before=x"):
        page = filters.page("/x", {}, found[1:])
    assert (page.rows, page.older, page.newest) == (found[1:], None, None)


def test_all_that_fits_is_a_file():
    """Of either kind, under what the page shows."""
    assert filters.files("/x", asked("robot=r")) == [
        ("csv", "/x/download?robot=r&format=csv"),
        ("jsonl", "/x/download?robot=r&format=jsonl"),
    ]


def test_file_of_another_kind_is_refused():
    """There are files for spreadsheets and for programs."""
    with (
        Flask("x").test_request_context("/?format=pdf"),
        pytest.raises(FieldInvalidError, match="format: it must be one of csv, jsonl"),
    ):
        filters.file_kind()

"""What a page is asked to look for."""

import datetime as dt

import pytest
from flask import Flask
from robotether_server.problems import FieldInvalidError
from robotether_server.web import filters

NAMES = ("robot", "since", "until")


def asked(query):
    with Flask("x").test_request_context(f"/?{query}"):
        return filters.query_of(NAMES)


def test_days_are_whole_and_timestamps_taken_as_they_are():
    found = asked("robot=+sim1&since=2026-01-30&until=2026-01-31&other=1")
    assert found == {"robot": "sim1", "since": "2026-01-30", "until": "2026-01-31"}
    assert filters.since(found) == dt.datetime(2026, 1, 30, tzinfo=dt.UTC)
    assert filters.until(found) == dt.datetime(2026, 2, 1, tzinfo=dt.UTC)
    found = asked("until=2026-01-31T12:00:00Z")
    noon = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)
    assert (filters.since(found), filters.until(found)) == (None, noon)


@pytest.mark.parametrize("text", ["x", "2026-02-30", "9999-12-31"])
def test_what_is_no_day_is_refused(text):
    """The last day that a computer knows has none after it."""
    with pytest.raises(FieldInvalidError, match="cannot use To"):
        filters.until(asked(f"until={text}"))

"""The audit log: filtered, and paged from the newest to the oldest."""

import json
import re

import pytest
from robotether_server.db import audit
from robotether_server.db.audit import Source
from robotether_server.web.filters import PER_PAGE


@pytest.fixture(autouse=True)
def _events(database):
    """Events of two actors, more than a page has."""
    with database.transaction() as tx:
        audit.record(tx, Source("zoe", "203.0.113.9"), "grant_given", "sim1", user="olga")
        for number in range(PER_PAGE):
            audit.record(tx, Source("ann"), "counted", "sim2", number=number)


def test_events_are_found(admin):
    for query in ("robot=sim1", "actor=zoe", "kind=grant_given"):
        page = admin.ask("GET", f"/admin/audit?{query}").text
        assert "user: olga" in page
        assert "number:" not in page
        [line] = admin.ask("GET", f"/admin/audit/download?format=jsonl&{query}").text.splitlines()
        assert json.loads(line)["details"] == {"user": "olga"}


def test_older_pages_go_on_where_the_newer_ended(admin):
    page = admin.ask("GET", "/admin/audit?robot=sim2").text
    assert page.count("number: ") == PER_PAGE
    assert "Older" not in page
    page = admin.ask("GET", "/admin/audit").text
    assert "user: olga" not in page
    older = re.findall(r'href="([^"]+)" data-testid="older"', page)[0]
    page = admin.ask("GET", older.replace("&amp;", "&")).text
    assert "user: olga" in page
    assert "Newest" in page
    assert "Older" not in page


def test_nothing_fits(admin):
    """The page leads back to everything, and takes nonsense for no page at all."""
    page = admin.ask("GET", "/admin/audit?robot=ghost&before=x").text
    assert "Nothing matches" in page


def test_a_day_is_whole_and_a_wrong_one_is_said(admin, admin_database):
    with admin_database.transaction() as tx:
        tx.change("UPDATE audit_events SET at = '2026-01-31 23:59:59.5' WHERE actor = 'zoe'")
    for query in ("since=2026-01-31&until=2026-01-31", "until=2026-02-01T00:00:00Z"):
        assert "user: olga" in admin.ask("GET", f"/admin/audit?actor=zoe&{query}").text
    for query in ("since=2026-02-01", "until=2026-01-30", "until=2026-01-31T23:59:59Z"):
        assert "Nothing matches" in admin.ask("GET", f"/admin/audit?actor=zoe&{query}").text
    # The last day that a computer knows has none after it.
    for name, wrong in (
        ("since", "soon"),
        ("until", "2026-02-30"),
        ("until", "9999-12-31"),
        ("kind", "misspelt"),
    ):
        answer = admin.ask("GET", f"/admin/audit?{name}={wrong}")
        assert (answer.status_code, "form-problem" in answer.text) == (422, True), wrong
        assert wrong in answer.text

"""The audit log in the real database."""

from __future__ import annotations

import datetime as dt

from robotether_server.store import Database, audit
from robotether_server.store.audit import Event, Source


def test_event_is_written_with_who_where_and_what(database: Database) -> None:
    """A name that somebody claimed is cut to fit, whatever it is."""
    with database.transaction() as tx:
        audit.record(tx, Source("é" * 70, "192.0.2.1"), Event("login_failed", "sim1", {"a": "ü"}))
        row = tx.row("SELECT actor, kind, robot, address, details FROM audit_events")
    assert row == {
        "actor": "é" * 63,
        "kind": "login_failed",
        "robot": "sim1",
        "address": "192.0.2.1",
        "details": '{"a": "\\u00fc"}',
    }


def test_recent_moments_are_of_one_kind_address_and_time(database: Database) -> None:
    """The oldest comes first."""
    now = dt.datetime.now(dt.UTC)
    with database.transaction() as tx:
        for actor, kind, address in (
            ("ann", "login_failed", "192.0.2.1"),
            ("bob", "login_failed", "192.0.2.1"),
            ("ann", "login", "192.0.2.1"),
            ("ann", "login_failed", "192.0.2.2"),
        ):
            audit.record(tx, Source(actor, address), Event(kind))
        minute = dt.timedelta(minutes=1)
        recent = audit.recent_moments(tx, "login_failed", "192.0.2.1", now - minute)
        assert [actor for actor, _ in recent] == ["ann", "bob"]
        assert recent[0][1] <= recent[1][1]
        assert audit.recent_moments(tx, "login_failed", "192.0.2.1", now + minute) == []

"""robotether audit."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from admin_records import ADD, kinds
from mariadb_server import MariaDb
from robotether_server.store import Database, audit

Run = Callable[..., Any]


def test_log_is_shown_newest_last(run: Run) -> None:
    """All of it, or what fits the question."""
    run("user", "add", "ann")
    run(*ADD)
    heads, first, second = run("audit").out.splitlines()
    assert heads.split() == ["AT", "WHO", "FROM", "WHAT", "ROBOT", "DETAILS"]
    assert 'user_added   -      user="ann" role="user"' in first
    assert "robot_added" in second
    for question in (("--robot", "sim1"), ("--kind", "robot_added"), ("--limit", "1")):
        [one] = json.loads(run("audit", *question, "--json").out)
        assert (one["kind"], one["actor"], one["robot"]) == ("robot_added", "cli", "sim1")
    assert json.loads(run("audit", "--actor", "nobody", "--json").out) == []


def test_site_itself_removes_nothing_from_the_log(run: Run) -> None:
    """The sentence has the command that may."""
    done = run("audit", "prune", "--days", "30")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "tools/compose run --rm migrate robotether audit prune --days 30" in done.err


def test_old_events_are_removed(
    run: Run,
    database: Database,
    admin_database: Database,
    mariadb: MariaDb,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Piece by piece, as account migrate; the log says that it was done."""
    monkeypatch.setattr(audit, "REMOVED_AT_ONCE", 2)
    run(*ADD)
    with admin_database.transaction() as tx:
        for _ in range(5):
            tx.insert(
                "INSERT INTO audit_events (at, actor, kind, details) "
                "VALUES (CURRENT_TIMESTAMP - INTERVAL 40 DAY, 'cli', 'old', '{}')"
            )
    settings = mariadb.settings("migrate")
    monkeypatch.setenv("DB_USER", settings.user)
    monkeypatch.setenv("DB_PASSWORD", settings.password)
    assert run("audit", "prune", "--days", "30").out.startswith("removed 5 events from before ")
    assert kinds(database) == ["robot_added", "audit_pruned"]

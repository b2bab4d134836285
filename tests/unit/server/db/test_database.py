"""Transactions: all or nothing, times in UTC, and database errors in our own words."""

from __future__ import annotations

import datetime as dt

import pymysql
import pytest
from mariadb_server import MariaDb
from robotether_server.db import Database
from robotether_server.db.database import translate
from robotether_server.problems import RecordExists, RecordRefused, StoreUnavailable
from robotether_server.settings import DatabaseSettings

ADD_USER = "INSERT INTO users (name, password_hash, role) VALUES (%s, 'x', %s)"


def test_block_that_raises_leaves_nothing(database: Database) -> None:
    """What was done in the block is rolled back."""

    def fail() -> None:
        with database.transaction() as tx:
            tx.insert(ADD_USER, ("ann", "user"))
            raise LookupError

    with pytest.raises(LookupError):
        fail()
    with database.transaction() as tx:
        assert tx.rows("SELECT * FROM users") == []
        assert tx.row("SELECT * FROM users") is None


def test_moments_are_aware_and_in_utc(database: Database) -> None:
    """A moment that goes in comes out the same, to the microsecond."""
    timestamp = dt.datetime(2026, 7, 1, 12, 3, 4, 123456, tzinfo=dt.UTC)
    with database.transaction() as tx:
        user_id = tx.insert(ADD_USER, ("ann", "user"))
        tx.change("UPDATE users SET created_at = %s WHERE id = %s", (timestamp, user_id))
        row = tx.row("SELECT created_at, updated_at FROM users")
        assert row is not None
        assert row["created_at"] == timestamp
        assert abs(dt.datetime.now(dt.UTC) - row["updated_at"]) < dt.timedelta(minutes=1)


@pytest.mark.parametrize(
    ("name", "role", "problem"),
    [
        ("ann", "user", RecordExists),
        ("Ann", "user", RecordRefused),
        ("bob\n", "user", RecordRefused),
        ("x" * 64, "user", RecordRefused),
        (None, "user", RecordRefused),
        ("bob", "king", RecordRefused),
    ],
)
def test_refused_rows_are_problems(
    database: Database, name: str | None, role: str, problem: type[Exception]
) -> None:
    """Twice the same, a check, too long, missing, no such choice."""
    with database.transaction() as tx:
        tx.insert(ADD_USER, ("ann", "user"))
        with pytest.raises(problem):
            tx.insert(ADD_USER, (name, role))


def test_unique_key_is_named(database: Database) -> None:
    """Callers can tell which of a table's keys it was."""
    with database.transaction() as tx:
        tx.insert(ADD_USER, ("ann", "user"))
        with pytest.raises(RecordExists) as exists:
            tx.insert(ADD_USER, ("ann", "user"))
    assert exists.value.key == "name"


def test_mistake_in_a_statement_is_no_problem(database: Database) -> None:
    """What is our own fault is not dressed up as the visitor's."""
    with database.transaction() as tx, pytest.raises(pymysql.ProgrammingError):
        tx.rows("SELECT FROM nowhere")


def test_server_that_is_away_is_unavailable() -> None:
    """Nothing listens there; the sentence for visitors names no host."""
    database = Database(DatabaseSettings("127.0.0.1", 1, "robotether", "web", "x"))
    with pytest.raises(StoreUnavailable) as unavailable, database.transaction():
        pass
    assert "127.0.0.1" not in unavailable.value.detail


def test_wrong_password_is_unavailable_and_not_shown(mariadb: MariaDb) -> None:
    """A secret that is out of step is the server's trouble, and stays unseen."""
    port = mariadb.settings("web").port
    database = Database(DatabaseSettings("127.0.0.1", port, "robotether", "web", "not-the-one"))
    with pytest.raises(StoreUnavailable) as unavailable, database.transaction():
        pass
    assert "not-the-one" not in f"{unavailable.value.detail} {unavailable.value.__cause__}"


def test_connection_that_is_cut_is_unavailable(database: Database, mariadb: MariaDb) -> None:
    """A server that goes away in mid-transaction is said so."""
    with pytest.raises(LookupError), database.transaction() as tx:  # noqa: PT012 - what is left cannot be committed
        row = tx.row("SELECT CONNECTION_ID() AS id")
        assert row is not None
        mariadb.as_root(f"KILL {row['id']}")
        with pytest.raises(StoreUnavailable):
            tx.rows("SELECT 1")
        raise LookupError


@pytest.mark.parametrize("number", [1040, 1205, 1213, 1226, 2003, 2006, 2013])
def test_busy_server_is_unavailable(number: int) -> None:
    """Too many connections, lock waits, deadlocks and lost connections may go better later."""
    assert isinstance(translate(pymysql.OperationalError(number, "x")), StoreUnavailable)

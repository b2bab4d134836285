"""How long the history is kept, and that the database prunes what is older."""

from __future__ import annotations

from mariadb_server import MariaDb
from robotether_server.db import Database, Transaction, retention, robots


def fill(tx: Transaction) -> None:
    """Something new and something of two years ago in each table; a's newest session is old, too."""
    old = "CURRENT_TIMESTAMP(6) - INTERVAL 2 YEAR"
    for name, number in (("a", 1), ("b", 2)):
        robots.add(tx, f"02:00:00:00:00:0{number}", name)
    for at in (old, "CURRENT_TIMESTAMP(6)"):
        tx.change(f"INSERT INTO audit_events (at, actor, kind) VALUES ({at}, 'x', 'y')")
        tx.change(
            "INSERT INTO drives (robot, user_name, fence, started_at, ended_at) "
            f"VALUES ('a', 'ann', 1, {at}, {at})"
        )
    tx.change(
        f"INSERT INTO drives (robot, user_name, fence, started_at) VALUES ('a', 'go', 1, {old})"
    )
    for name, ended in (("a", old), ("a", old), ("b", old), ("b", "NULL")):
        tx.change(
            "INSERT INTO robot_sessions (robot_id, started_at, ended_at, address) "
            f"SELECT id, {old}, {ended}, '' FROM robots WHERE name = '{name}'"
        )


def counts(tx: Transaction) -> tuple[int, int, int]:
    """How much there is: events, drives, sessions."""
    tables = ("audit_events", "drives", "robot_sessions")
    rows = [tx.row(f"SELECT COUNT(*) AS rows_ FROM {table}") or {} for table in tables]
    return rows[0]["rows_"], rows[1]["rows_"], rows[2]["rows_"]


def test_old_history_goes_and_what_goes_on_stays(admin_database: Database) -> None:
    """So does each robot's newest session, which tells since when it is away."""
    with admin_database.transaction() as tx:
        fill(tx)
        retention.set_days(tx, 365)
        tx.change("CALL prune_history()")
        assert counts(tx) == (1, 2, 2)


def test_zero_days_are_for_ever(admin_database: Database) -> None:
    """And the last number that was set holds."""
    with admin_database.transaction() as tx:
        fill(tx)
        retention.set_days(tx, 365)
        retention.set_days(tx, 0)
        tx.change("CALL prune_history()")
        assert counts(tx) == (2, 3, 4)


def test_database_prunes_by_itself(mariadb: MariaDb) -> None:
    """The scheduler runs, and so does the event, as account migrate."""
    assert mariadb.as_root("SELECT @@GLOBAL.event_scheduler").strip() == "ON"
    event = mariadb.as_root("SHOW EVENTS").split("\t")
    assert event[1:3] == ["prune_history", "migrate@%"]
    assert "ENABLED" in event

"""Brings the database to this version's schema, then to the ranges of ports and the retention that are set.

Started by `robotether migrate` as account migrate, once at each start of the stack. Safe to run
again, to run twice at once, and after a run that was cut short. Must never drop records. Only it writes the ranges
that ports are allotted from (sql/0002_ports_and_macs.sql, 0006) and how long the history is kept
(sql/0010_control_views.sql); the database itself allots and prunes.
"""

import logging
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pymysql
from pymysql.constants import CLIENT
from pymysql.cursors import Cursor

from robotether_server.db import Database
from robotether_server.db.database import CONNECT_TIMEOUT_S, Transaction, connect_options
from robotether_server.problems import MigrationFailedError, StoreUnavailableError
from robotether_server.settings.server import DatabaseSettings, MigrateSettings

logger = logging.getLogger(__name__)

LOCK_WAIT_S = 10


def migrate(settings: MigrateSettings) -> list[str]:
    """Apply what is missing; return the names of the migrations applied now.

    Raises StoreUnavailableError or MigrationFailedError.
    """
    files = sorted(settings.migrations_dir.glob("*.sql"))
    if not files:
        raise MigrationFailedError(
            f"cannot migrate: MIGRATIONS_DIR={str(settings.migrations_dir)!r} has no migrations"
        )
    database = Database(settings.database)
    with _only_one(database):
        applied = _apply(settings.database, files)
        with database.transaction() as tx:
            set_port_range(tx, settings.port_range_first, settings.port_range_last)
            set_shell_port_range(tx, settings.shell_port_first, settings.shell_port_last)
            set_audit_days(tx, settings.audit_days)
    return applied


@contextmanager
def _only_one(database: Database) -> Iterator[None]:
    """Keep other migrations out: the server frees this lock itself when its holder dies."""
    with database.transaction() as tx:
        if not tx.lock("robotether.migrate", LOCK_WAIT_S):
            raise StoreUnavailableError(
                f"cannot migrate: another migration has been running for {LOCK_WAIT_S} s; "
                "wait for it to end"
            )
        yield


def _apply(settings: DatabaseSettings, files: list[Path]) -> list[str]:
    with closing(_connect(settings)) as connection, connection.cursor() as cursor:
        versions = _applied(cursor)
        missing = [file for file in files if file.stem not in versions]
        for file in missing:
            _apply_one(cursor, file)
        return [file.stem for file in missing]


def _connect(settings: DatabaseSettings) -> "pymysql.Connection[Cursor]":
    """Return a connection on which a statement may take its time, and is committed by itself."""
    return pymysql.connect(
        **connect_options(settings),
        autocommit=True,
        client_flag=CLIENT.MULTI_STATEMENTS,
        connect_timeout=CONNECT_TIMEOUT_S,
    )


def _applied(cursor: Cursor) -> set[str]:
    """Return the names of the applied migrations; make their table where it is missing."""
    cursor.execute(
        "CREATE TABLE IF NOT EXISTS schema_migrations (name VARCHAR(255) NOT NULL PRIMARY KEY, "
        "applied_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6)) "
        "CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin"
    )
    cursor.execute("SELECT name FROM schema_migrations")
    return {name for (name,) in cursor.fetchall()}


def _apply_one(cursor: Cursor, file: Path) -> None:
    """Run all statements of a file, which the database itself separates: a routine's body has semicolons, too."""
    try:
        cursor.execute(file.read_text(encoding="utf-8"))
        while cursor.nextset():
            pass
        cursor.execute("INSERT INTO schema_migrations (name) VALUES (%s)", (file.stem,))
    except pymysql.MySQLError as error:
        raise MigrationFailedError(
            f"cannot apply migration {file.stem}: {error}; nothing after it was applied"
        ) from error
    logger.info("applied migration %s", file.stem)


def set_port_range(tx: Transaction, first: int, last: int) -> None:
    """Make the pairs `first`, `first` + 2, ... up to `last` the ones to allot from.

    Pairs in use stay, even outside the range; so do the ports of every robot.
    """
    tx.change(
        "DELETE FROM port_pairs WHERE robot_id IS NULL "
        "AND (ros_port < %s OR video_port > %s OR MOD(ros_port + %s, 2) = 1)",
        (first, last, first),
    )
    tx.change_many(
        "INSERT IGNORE INTO port_pairs (ros_port) VALUES (%s)",
        [(ros_port,) for ros_port in range(first, last, 2)],
    )
    # A robot may have been given ports by hand, or a shell, where there were no pairs until now.
    tx.change(
        "UPDATE port_pairs p JOIN robots r ON r.ros_port IN (p.ros_port, p.video_port) "
        "OR r.video_port IN (p.ros_port, p.video_port) "
        "OR r.shell_port IN (p.ros_port, p.video_port) "
        "SET p.robot_id = r.id WHERE p.robot_id IS NULL"
    )


def set_shell_port_range(tx: Transaction, first: int, last: int) -> None:
    """Make the ports `first` to `last` the ones to allot to shells.

    Ports in use stay, even outside the range; a port that a robot was given by hand for ROS or video is left out.
    """
    tx.change(
        "DELETE FROM shell_ports WHERE robot_id IS NULL AND NOT port BETWEEN %s AND %s",
        (first, last),
    )
    rows = tx.rows("SELECT ros_port, video_port FROM robots")
    ports = {row[column] for row in rows for column in ("ros_port", "video_port")}
    tx.change_many(
        "INSERT IGNORE INTO shell_ports (port) VALUES (%s)",
        [(port,) for port in range(first, last + 1) if port not in ports],
    )


def set_audit_days(tx: Transaction, days: int) -> None:
    """Set the number of days for which audit log, drives and sessions are kept; 0 is for ever."""
    tx.change(
        "INSERT INTO retention (id, days) VALUES (1, %s) ON DUPLICATE KEY UPDATE days = VALUES(days)",
        (days,),
    )

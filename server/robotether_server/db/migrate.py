"""Brings the database to this version's schema, then to the ranges of ports and the retention that are set.

Started by `robotether migrate` as account migrate, once at each start of the stack. Safe to run
again, to run twice at once, and after a run that was cut short. Must never drop records. Only it writes the ranges
that ports are allotted from (sql/0002_ports_and_macs.sql, 0006) and how long the history is kept
(sql/0010_control_views.sql); the database itself allots and prunes.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pymysql
import yoyo
from yoyo.backends.core.mysql import MySQLBackend
from yoyo.connections import DatabaseURI
from yoyo.exceptions import BadMigration
from yoyo.migrations import default_migration_table

from robotether_server.db import Database
from robotether_server.db.database import Transaction
from robotether_server.problems import MigrationFailed, StoreUnavailable
from robotether_server.settings import DatabaseSettings, MigrateSettings

logger = logging.getLogger(__name__)

LOCK_WAIT_S = 10
CONNECT_TIMEOUT_S = 5


def migrate(settings: MigrateSettings) -> list[str]:
    """Apply what is missing; return the names of the migrations applied now.

    Raises StoreUnavailable or MigrationFailed.
    """
    database = Database(settings.database)
    with _only_one(database):
        applied = _apply(settings)
        with database.transaction() as tx:
            set_port_range(tx, settings.port_range_first, settings.port_range_last)
            set_shell_port_range(tx, settings.shell_port_first, settings.shell_port_last)
            set_audit_days(tx, settings.audit_days)
    return applied


@contextmanager
def _only_one(database: Database) -> Iterator[None]:
    """Keep other migrations out: the server frees this lock itself when its holder dies.

    yoyo's own lock is a row, which a killed migration would leave behind for good.
    """
    with database.transaction() as tx:
        row = tx.row("SELECT GET_LOCK('robotether.migrate', %s) AS held", (LOCK_WAIT_S,))
        if not row or row["held"] != 1:
            raise StoreUnavailable(
                f"cannot migrate: another migration has been running for {LOCK_WAIT_S} s; "
                "wait for it to end"
            )
        yield


def _apply(settings: MigrateSettings) -> list[str]:
    migrations = yoyo.read_migrations(str(settings.migrations_dir))
    if not migrations:
        raise MigrationFailed(
            f"cannot migrate: MIGRATIONS_DIR={str(settings.migrations_dir)!r} has no migrations"
        )
    with _Backend(_address(settings.database), default_migration_table) as backend:
        backend.init_database()
        # This run holds the real lock, so a row here is left from a migration that was killed.
        backend.break_lock()
        missing = list(backend.to_apply(migrations))
        for migration in missing:
            _apply_one(backend, migration)
        return [str(migration.id) for migration in missing]


def _apply_one(backend: Any, migration: Any) -> None:
    try:
        backend.apply_one(migration)
    except (BadMigration, pymysql.MySQLError) as error:
        raise MigrationFailed(
            f"cannot apply migration {migration.id}: {error}; nothing after it was applied"
        ) from error
    logger.info("applied migration %s", migration.id)


def _address(settings: DatabaseSettings) -> DatabaseURI:
    return DatabaseURI(
        "mysql",
        settings.user,
        settings.password,
        settings.host,
        settings.port,
        settings.name,
        {},
    )


class _Backend(MySQLBackend):  # type: ignore[misc] # yoyo has no types
    """yoyo's own, less the arguments that pymysql calls deprecated, and with a time limit."""

    def connect(self, dburi: DatabaseURI) -> "pymysql.Connection[pymysql.cursors.Cursor]":
        return pymysql.connect(
            host=dburi.hostname,
            port=dburi.port,
            user=dburi.username,
            password=dburi.password,
            database=dburi.database,
            charset="utf8mb4",
            connect_timeout=CONNECT_TIMEOUT_S,
        )


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
    taken = {row[column] for row in rows for column in ("ros_port", "video_port")}
    tx.change_many(
        "INSERT IGNORE INTO shell_ports (port) VALUES (%s)",
        [(port,) for port in range(first, last + 1) if port not in taken],
    )


def set_audit_days(tx: Transaction, days: int) -> None:
    """Keep audit log, drives and sessions for so many days; 0 is for ever."""
    tx.change(
        "INSERT INTO retention (id, days) VALUES (1, %s) ON DUPLICATE KEY UPDATE days = VALUES(days)",
        (days,),
    )

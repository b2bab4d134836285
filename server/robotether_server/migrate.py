"""Brings the database to this version's schema, then to the ranges of ports and the retention that are set.

Started by `robotether migrate` as account migrate, once at each start of the stack. Safe to run
again, to run twice at once, and after a run that was cut short. Must never drop records.
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

from robotether_server.db import Database, ports, retention
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
            ports.set_range(tx, settings.port_range_first, settings.port_range_last)
            ports.set_shell_range(tx, settings.shell_port_first, settings.shell_port_last)
            retention.set_days(tx, settings.audit_days)
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
                f"cannot migrate: another migration has been at work for {LOCK_WAIT_S} s; "
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

"""Fixtures for tests that need the real database: one server a run, clean tables a test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import mariadb_server
import pytest
from hypothesis import HealthCheck, Phase, settings
from mariadb_server import MariaDb
from outside import marks_of
from robotether_server.db import Database
from robotether_server.db.migrate import (
    migrate,
    set_audit_days,
    set_port_range,
    set_shell_port_range,
)
from robotether_server.settings.server import MigrateSettings

# The first and the last judge the speed of the machine that tests, and not what is tested. Continuous integration plays
# the same examples each time, so that a failure is the change's; elsewhere new ones are looked for. For a mutant
# (tools/mutants.py) the first failure is enough. `make check` asks for `quick`, a quarter of the examples.
settings.register_profile(
    "any machine",
    deadline=None,
    derandomize="CI" in os.environ,
    phases=tuple(set(Phase) - {Phase.shrink})
    if "MUTANT_UNDER_TEST" in os.environ
    else tuple(Phase),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("quick", settings.get_profile("any machine"), max_examples=25)
settings.load_profile("any machine")

SQL_DIR = mariadb_server.ROOT / "sql"
FIRST_PORT = 20000
LAST_PORT = 20199
FIRST_SHELL_PORT = 24000
LAST_SHELL_PORT = 24049
TABLES = (
    "audit_events",
    "audit_chains",
    "audit_heads",
    "robot_sessions",
    "drives",
    "logins",
    "api_tokens",
    "grants",
    "key_claims",
    "refused_joins",
    "join_tokens",
    "user_ssh_keys",
    "robots",
    "sites",
    "user_groups",
    "users",
    "port_pairs",
    "shell_ports",
    "cells",
    "recordings",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that start processes or wait, so that `make check` can leave them out."""
    for item in items:
        for mark in marks_of(item):
            item.add_marker(mark)


@pytest.fixture(scope="session")
def mariadb(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MariaDb]:
    """A MariaDB server of this run alone, migrated."""
    with mariadb_server.running(tmp_path_factory.mktemp("secrets")) as server:
        ranges = (FIRST_PORT, LAST_PORT, FIRST_SHELL_PORT, LAST_SHELL_PORT)
        migrate(MigrateSettings(server.settings("migrate"), SQL_DIR, *ranges))
        yield server


@pytest.fixture
def admin_database(mariadb: MariaDb) -> Database:
    """The database as account migrate, which may read and change every table; emptied."""
    database = Database(mariadb.settings("migrate"))
    with database.transaction() as tx:
        for table in TABLES:
            tx.change("DELETE FROM " + table)
        # A plan may be due at once, also just after the migration.
        tx.change("UPDATE planner SET planned_at = '2000-01-01'")
        set_audit_days(tx, 365)
        set_port_range(tx, FIRST_PORT, LAST_PORT)
        set_shell_port_range(tx, FIRST_SHELL_PORT, LAST_SHELL_PORT)
    return database


@pytest.fixture
def database(mariadb: MariaDb, admin_database: Database) -> Database:
    """The emptied database as account web, as the product itself uses it."""
    return Database(mariadb.settings("web"))


@pytest.fixture
def relay_database(mariadb: MariaDb, database: Database) -> Database:
    """The emptied database as account relay."""
    assert database
    return Database(mariadb.settings("relay"))


@pytest.fixture
def recorder_database(mariadb: MariaDb, database: Database) -> Database:
    """The emptied database as account recorder."""
    assert database
    return Database(mariadb.settings("recorder"))


@pytest.fixture
def sql_dir() -> Path:
    """The folder of the migrations."""
    return SQL_DIR

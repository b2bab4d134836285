"""Fixtures for tests that need the real database: one server a run, clean tables a test."""

import os
from functools import cache
from inspect import unwrap
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import mariadb_server
import pytest
from hypothesis import HealthCheck, Phase, settings
from robotether_server.db import Database
from robotether_server.db.migrate import (
    migrate,
    set_audit_days,
    set_port_range,
    set_shell_port_range,
)
from robotether_server.settings.server import MigrateSettings

TESTS = str(Path(__file__).resolve().parents[1])
# Of each mark: modules, and functions and classes of any module.
NAMES = {
    "daemon": {
        *("docker", "multiprocessing", "subprocess"),
        *("create_subprocess_exec", "create_subprocess_shell", "sync_playwright"),
    },
    "waits": {
        *("sleep", "open_connection", "open_unix_connection", "start_server", "start_unix_server"),
        *("AppRunner", "ClientSession", "TCPSite", "create_connection", "create_server"),
    },
}


def marks_of(item):
    """Say what a test, its fixtures, or code of the tests that they name, however far, may do."""
    if not isinstance(item, pytest.Function):
        return list(NAMES)
    everyones = [
        entry.func for found in item._fixtureinfo.name2fixturedefs.values() for entry in found
    ]
    functions = {
        "daemon": [item.function, *everyones],
        # What all tests of a folder do at their end is no reason.
        "waits": [item.function, *fixtures_of(item)],
    }
    return [mark for mark in NAMES if any(may(mark, function) for function in functions[mark])]


def fixtures_of(item):
    """Functions of the fixtures that a test asks for, also by way of others."""
    found = item._fixtureinfo.name2fixturedefs
    asked = {mark for marker in item.iter_markers("usefixtures") for mark in marker.args}
    waiting, seen = [*item._fixtureinfo.argnames, *asked], set[str]()
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            for fixture in found.get(name, ()):
                waiting += fixture.argnames
                yield fixture.func


@cache
def may(mark, start):
    """Whether the function or class names what the mark is about, or something of the tests that does."""
    seen = set()
    waiting = {start}
    while waiting:
        found = waiting.pop()
        seen.add(found)
        names, reached = named_by(found)
        if names & NAMES[mark]:
            return True
        waiting |= reached - seen
    return False


@cache
def named_by(found):
    """All names that a function or class looks up, and the functions and classes behind them."""
    every, reached = set[str](), set[object]()
    for function in functions_of(found):
        names = names_in(function.__code__)
        values = [function.__globals__.get(name) for name in names]
        for module in [value for value in values if isinstance(value, ModuleType)]:
            values += [vars(module).get(name) for name in names]
        every |= names
        reached |= {value for value in values if isinstance(value, FunctionType | type)}
    return frozenset(every), frozenset(reached)


def functions_of(found):
    """Functions of the tests' own code: the function itself, or a class's."""
    if isinstance(found, type):
        inside = [value for base in found.__mro__ for value in vars(base).values()]
        values = [getattr(value, "__func__", getattr(value, "fget", value)) for value in inside]
    else:
        values = [found]
    for value in values:
        # A decorator such as contextmanager has wrapped it.
        function = unwrap(value) if isinstance(value, FunctionType) else None
        if isinstance(function, FunctionType) and function.__code__.co_filename.startswith(TESTS):
            yield function


@cache
def names_in(code):
    inner = (names_in(const) for const in code.co_consts if isinstance(const, CodeType))
    return frozenset(code.co_names).union(*inner)


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


def pytest_collection_modifyitems(items):
    """Mark the tests that start processes or wait, so that `make check` can leave them out."""
    for item in items:
        for mark in marks_of(item):
            item.add_marker(mark)


@pytest.fixture(scope="session")
def mariadb(tmp_path_factory):
    """A MariaDB server of this run alone, migrated."""
    with mariadb_server.running(tmp_path_factory.mktemp("secrets")) as server:
        ranges = (FIRST_PORT, LAST_PORT, FIRST_SHELL_PORT, LAST_SHELL_PORT)
        migrate(MigrateSettings(server.settings("migrate"), SQL_DIR, *ranges))
        yield server


@pytest.fixture
def admin_database(mariadb):
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
def database(mariadb, admin_database):
    """The emptied database as account web, as the product itself uses it."""
    return Database(mariadb.settings("web"))


@pytest.fixture
def relay_database(mariadb, database):
    """The emptied database as account relay."""
    assert database
    return Database(mariadb.settings("relay"))


@pytest.fixture
def recorder_database(mariadb, database):
    """The emptied database as account recorder."""
    assert database
    return Database(mariadb.settings("recorder"))


@pytest.fixture
def sql_dir():
    """The folder of the migrations."""
    return SQL_DIR

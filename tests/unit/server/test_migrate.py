"""Migrations: applied to the real MariaDB, again and again, and the range of ports after them."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
import sqlparse
from mariadb_server import MariaDb
from robotether_server.migrate import migrate
from robotether_server.problems import MigrationFailed, StoreUnavailable
from robotether_server.settings import DatabaseSettings, MigrateSettings
from robotether_server.store import Database


def settings(
    mariadb: MariaDb, folder: Path, first: int = 20000, last: int = 20199
) -> MigrateSettings:
    return MigrateSettings(mariadb.settings("migrate"), folder, first, last, 24000, 24049)


def test_every_file_splits_into_whole_statements(sql_dir: Path) -> None:
    """The library's splitter leaves no procedure or trigger cut in two."""
    for file in sql_dir.glob("*.sql"):
        for statement in sqlparse.split(file.read_text(encoding="ascii")):
            words = sqlparse.format(statement, strip_comments=True).split()
            assert words[0] in {"CREATE", "GRANT", "ALTER", "UPDATE"}, statement
            if {"TRIGGER", "PROCEDURE"} & set(words[:4]) and words[0] == "CREATE":
                assert words[-1] == "END;", statement


@pytest.mark.usefixtures("admin_database")
def test_second_run_applies_nothing(mariadb: MariaDb, sql_dir: Path) -> None:
    """A database that is up to date stays as it is."""
    assert migrate(settings(mariadb, sql_dir)) == []


def test_interrupted_run_is_finished_by_the_next(
    mariadb: MariaDb, admin_database: Database, sql_dir: Path
) -> None:
    """Every statement may run twice, so a migration that was cut short is applied again."""
    with admin_database.transaction() as tx:
        tx.change("DELETE FROM _yoyo_migration")
        tx.change("INSERT INTO yoyo_lock (locked, ctime, pid) VALUES (1, NOW(), 1)")
    applied = migrate(settings(mariadb, sql_dir))
    assert applied == sorted(file.stem for file in sql_dir.glob("*.sql"))


@pytest.mark.usefixtures("admin_database")
def test_broken_migration_is_named(mariadb: MariaDb, tmp_path: Path) -> None:
    """The failure says which file, and what the database said."""
    (tmp_path / "9999_broken.sql").write_text("-- transactional: false\nCREATE TABEL x (y INT);\n")
    with pytest.raises(MigrationFailed, match=r"9999_broken.*TABEL"):
        migrate(settings(mariadb, tmp_path))


@pytest.mark.usefixtures("admin_database")
def test_empty_folder_is_refused(mariadb: MariaDb, tmp_path: Path) -> None:
    """A wrong MIGRATIONS_DIR does not pass as a database that is up to date."""
    with pytest.raises(MigrationFailed, match="MIGRATIONS_DIR"):
        migrate(settings(mariadb, tmp_path))


def test_server_that_is_away_is_said_so(sql_dir: Path) -> None:
    """Nothing listens: a problem, and no traceback of a library."""
    nowhere = DatabaseSettings("127.0.0.1", 1, "robotether", "migrate", "x")
    with pytest.raises(StoreUnavailable):
        migrate(MigrateSettings(nowhere, sql_dir, 20000, 20001, 24000, 24000))


@pytest.mark.usefixtures("admin_database")
def test_two_migrations_at_once_take_turns(mariadb: MariaDb, sql_dir: Path) -> None:
    """Two servers that start together both end well."""
    done: list[list[str]] = []
    threads = [
        threading.Thread(target=lambda: done.append(migrate(settings(mariadb, sql_dir))))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert done == [[], [], []]

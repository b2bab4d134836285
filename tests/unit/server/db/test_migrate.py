"""Migrations: applied to the real MariaDB, again and again, and the range of ports after them."""

import threading

import pytest
from robotether_server.db import migrate as migrations
from robotether_server.db import robots
from robotether_server.db.migrate import migrate
from robotether_server.problems import MigrationFailedError
from robotether_server.settings.server import MigrateSettings


def settings(mariadb, folder, first=20000, last=20199):
    return MigrateSettings(mariadb.settings("migrate"), folder, first, last, 24000, 24049)


def test_every_statement_of_a_file_counts(mariadb, admin_database, tmp_path):
    """One that fails after others is not overlooked, and the file is applied again when it was mended."""
    file = tmp_path / "9999_several.sql"
    routine = "CREATE OR REPLACE PROCEDURE nine() BEGIN SET @a = 8; SELECT @a + 1 AS nine; END;\n"
    file.write_text(f"-- 100%; of it\n{routine}CALL nine();\nDROP PROCEDURE ten;\n")
    with pytest.raises(MigrationFailedError, match=r"9999_several.*ten does not exist"):
        migrate(settings(mariadb, tmp_path))
    file.write_text(f"{routine}CALL nine();\nDROP PROCEDURE nine;\n")
    assert migrate(settings(mariadb, tmp_path)) == ["9999_several"]
    assert migrate(settings(mariadb, tmp_path)) == []
    # A wrong MIGRATIONS_DIR does not pass as a database that is up to date.
    (tmp_path / "none").mkdir()
    with pytest.raises(MigrationFailedError, match="MIGRATIONS_DIR"):
        migrate(settings(mariadb, tmp_path / "none"))
    with admin_database.transaction() as tx:
        assert tx.row("SHOW PROCEDURE STATUS WHERE name = 'nine'") is None
        tx.change("DELETE FROM schema_migrations WHERE name = '9999_several'")


@pytest.mark.usefixtures("admin_database")
def test_two_migrations_at_once_take_turns(mariadb, sql_dir):
    done = []
    threads = [
        threading.Thread(target=lambda: done.append(migrate(settings(mariadb, sql_dir))))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert done == [[], [], []]


def pairs(admin_database):
    with admin_database.transaction() as tx:
        return [row["ros_port"] for row in tx.rows("SELECT * FROM port_pairs ORDER BY ros_port")]


def set_port_range(admin_database, first, last):
    with admin_database.transaction() as tx:
        migrations.set_port_range(tx, first, last)
    return pairs(admin_database)


def test_range_that_moves_by_one_overlaps_nobody(database, admin_database):
    """A pair that is in use stays, and blocks both new pairs that it touches; half a pair is none."""
    set_port_range(admin_database, 20000, 20007)
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:01", "a")
    assert set_port_range(admin_database, 19999, 20007) == [19999, 20000, 20001, 20003, 20005]
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:02", "b")
        assert robots.get(tx, "b").ros_port == 20003


def shell_ports(admin_database, first, last):
    with admin_database.transaction() as tx:
        migrations.set_shell_port_range(tx, first, last)
        return [row["port"] for row in tx.rows("SELECT port FROM shell_ports ORDER BY port")]


def test_ranges_that_move_onto_each_other_share_no_port(database, admin_database):
    """A port by hand is left out of the shells', and a shell's port is in no pair that is allotted."""
    with database.transaction() as tx:
        robots.set_ports(tx, robots.add(tx, "02:00:00:00:00:01", "a"), 30001, 30003)
        robots.set_shell(tx, robots.add(tx, "02:00:00:00:00:02", "b"), on=True)
    assert shell_ports(admin_database, 30000, 30003) == [24000, 30000, 30002]
    for first, last, name, ros_port in ((24000, 24003, "c", 24002), (30000, 30005, "d", 30004)):
        set_port_range(admin_database, first, last)
        with database.transaction() as tx:
            robots.add(tx, f"02:00:00:00:01:{ros_port % 100:02}", name)
            assert robots.get(tx, name).ros_port == ros_port


def fill(tx):
    """Something new and something of two years ago in each table; a's newest session is old, too."""
    old = "CURRENT_TIMESTAMP(6) - INTERVAL 2 YEAR"
    for name, number in (("a", 1), ("b", 2)):
        robots.add(tx, f"02:00:00:00:00:0{number}", name)
    for at in (old, "CURRENT_TIMESTAMP(6)"):
        tx.change(f"INSERT INTO audit_events (at, actor, kind) VALUES ({at}, 'x', 'y')")
        # As a line from before there were chains.
        tx.change("UPDATE audit_events SET position = NULL, hash = NULL")
        tx.change(
            "INSERT INTO drives (robot, user_name, fence, started_at, ended_at) "
            f"VALUES ('a', 'ann', 1, {at}, {at})"
        )
        tx.change(
            "INSERT INTO help_requests (robot_id, reason, source, priority, asked_by, state, closed_at) "
            f"SELECT id, '', 'api', 2, 'ann', 'closed', {at} FROM robots WHERE name = 'a'"
        )
    tx.change(
        "INSERT INTO help_requests (robot_id, reason, source, priority, asked_by, created_at) "
        f"SELECT id, '', 'api', 2, 'ann', {old} FROM robots WHERE name = 'a'"
    )
    tx.change(
        f"INSERT INTO drives (robot, user_name, fence, started_at) VALUES ('a', 'go', 1, {old})"
    )
    for name, ended in (("a", old), ("a", old), ("b", old), ("b", "NULL")):
        tx.change(
            "INSERT INTO robot_sessions (robot_id, started_at, ended_at, address) "
            f"SELECT id, {old}, {ended}, '' FROM robots WHERE name = '{name}'"
        )


def counts(tx):
    tables = ("audit_events", "drives", "robot_sessions", "help_requests")
    rows = [tx.row(f"SELECT COUNT(*) AS rows_ FROM {table}") or {} for table in tables]
    return tuple(row["rows_"] for row in rows)


def test_old_history_goes_and_what_goes_on_stays(admin_database):
    """So does each robot's newest session, which tells since when it is away; 0 days are for ever."""
    with admin_database.transaction() as tx:
        fill(tx)
        migrations.set_audit_days(tx, 0)
        tx.change("CALL prune_history()")
        assert counts(tx) == (2, 3, 4, 3)
        migrations.set_audit_days(tx, 365)
        tx.change("CALL prune_history()")
        assert counts(tx) == (1, 2, 2, 2)


def test_database_prunes_by_itself(mariadb):
    assert mariadb.as_root("SELECT @@GLOBAL.event_scheduler").strip() == "ON"
    event = mariadb.as_root("SHOW EVENTS").split("\t")
    assert event[1:3] == ["prune_history", "migrate@%"]
    assert "ENABLED" in event

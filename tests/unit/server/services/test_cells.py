"""Cells that admins take out of service and remove, in the real database."""

import datetime as dt

import pytest
from relay_server import cell_settings
from robotether_server.db import cells, control, fleet, recordings, robots, users
from robotether_server.db.audit import Source
from robotether_server.db.control import DriveEntry, NewLease
from robotether_server.db.fleet import SessionEntry
from robotether_server.db.recordings import RecordableRobot
from robotether_server.problems import NotPossibleError, StoreUnavailableError
from robotether_server.services import cells as cell_service

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)
ADMIN = Source("root")


@pytest.fixture
def database(database, relay_database):
    with relay_database.transaction() as tx:
        for name in ("a", "b"):
            cell = cell_settings(name, f"{name}.example")
            cells.write_heartbeat(tx, cell, cells.CellCounts(), NOON)
    return database


def kill(admin_database, name):
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = %s WHERE name = %s", (NOON, name))


def kinds(database):
    with database.transaction() as tx:
        return [row["kind"] for row in tx.rows("SELECT kind FROM audit_events ORDER BY id")]


def test_last_cell_in_service_is_not_drained(database, admin_database):
    with database.transaction() as tx:
        cell_service.drain(tx, ADMIN, "a")
        with pytest.raises(NotPossibleError, match="nowhere to go"):
            cell_service.drain(tx, ADMIN, "b")
        cell_service.resume(tx, ADMIN, "a")
    kill(admin_database, "a")
    with database.transaction() as tx, pytest.raises(NotPossibleError, match="nowhere to go"):
        cell_service.drain(tx, ADMIN, "b")


def test_of_two_drains_at_once_the_second_waits(database):
    with database.transaction() as tx, database.transaction() as other:
        cell_service.drain(tx, ADMIN, "a")
        other.change("SET innodb_lock_wait_timeout = 0")
        with pytest.raises(StoreUnavailableError):
            cell_service.drain(other, ADMIN, "b")


def test_removed_cell_leaves_nothing_open(
    database, relay_database, admin_database, recorder_database
):
    """Its sessions, drives, leases and recordings end; those of another cell go on."""
    with database.transaction() as tx:
        ann, sim1 = users.add(tx, "ann", "x", "user"), robots.add(tx, "00:1b:44:11:3a:b1", "sim1")
        sim2 = robots.add(tx, "00:1b:44:11:3a:b2", "sim2")
    with relay_database.transaction() as tx:
        for robot_id, cell in ((sim1, "a"), (sim2, "b")):
            control.next_fence(tx, NewLease(robot_id, ann, "ann", NOON), cell)
            drive = DriveEntry(robot_id, "sim", "ann", 1, NOON)
            fleet.write(tx, [SessionEntry(robot_id, NOON, ""), drive], cell)
    with recorder_database.transaction() as tx:
        for cell in ("a", "b"):
            recordings.add(tx, RecordableRobot(sim1, "sim1"), "always", cell, NOON)
    kill(admin_database, "a")
    with database.transaction() as tx:
        cell_service.remove(tx, ADMIN, "a")
    with database.transaction() as tx:
        for table in ("robot_sessions", "drives", "control_leases", "recordings"):
            rows = tx.rows(f"SELECT cell FROM {table} WHERE ended_at IS NULL")
            assert [row["cell"] for row in rows] == ["b"], table
        assert [cell.name for cell in cells.read(tx)] == ["b"]
    assert kinds(database) == ["drive_ended", "recording_ended", "cell_removed"]

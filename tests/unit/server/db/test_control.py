"""Leases, drives and stops in the real database, with the relay's own account."""

import datetime as dt

import pytest
from granted import give
from robotether_server.db import control, fleet, robots, users
from robotether_server.db.control import (
    DriveEntry,
    LeaseEnd,
    LeaseStart,
    NewLease,
    Stop,
    StopEntry,
    StoredControl,
)
from robotether_server.db.fleet import FormerSessions
from robotether_server.problems import RecordRefusedError

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)
HOUR = dt.timedelta(hours=1)


@pytest.fixture
def sim1(database):
    with database.transaction() as tx:
        return robots.add(tx, "00:1b:44:11:3a:b1", "sim1")


@pytest.fixture
def ann(database):
    with database.transaction() as tx:
        return users.add(tx, "ann", "x", "user")


def fence(database, robot_id, user_id, above=0):
    with database.transaction() as tx:
        return control.next_fence(tx, NewLease(robot_id, user_id, "ann", NOON, above))


def write(database, *entries):
    with database.transaction() as tx:
        return fleet.write(tx, entries)


def rows(database, table):
    with database.transaction() as tx:
        return tx.rows(f"SELECT * FROM {table}")


def test_numbers_grow_and_are_never_given_again(relay_database, sim1, ann):
    """A database that was restored from an older copy goes on where the relay is."""
    assert [fence(relay_database, sim1, ann) for _ in range(2)] == [1, 2]
    # The end of an older lease leaves the newer.
    write(relay_database, LeaseEnd(sim1, 1, NOON))
    assert rows(relay_database, "control_leases")[0]["ended_at"] is None
    write(relay_database, LeaseEnd(sim1, 2, NOON + HOUR))
    assert rows(relay_database, "control_leases")[0]["ended_at"] == NOON + HOUR
    assert [fence(relay_database, sim1, ann, above) for above in (0, 7, 3)] == [3, 8, 9]
    assert rows(relay_database, "control_leases")[0]["ended_at"] is None


@pytest.fixture
def ben(database, sim1):
    """The id of user ben, who drives sim1."""
    with database.transaction() as tx:
        user_id = users.add(tx, "ben", "x", "user")
        give(tx, user_id, sim1, "drive")
    return user_id


def lease(database):
    (row,) = rows(database, "control_leases")
    return tuple(row[name] for name in ("fence", "user_id", "user_name", "since", "ended_at"))


def test_a_lease_that_began_without_the_database_is_written_later(relay_database, sim1, ben):
    """Numbers go on above it, also where there was none."""
    write(relay_database, LeaseStart(sim1, 7, ben, "ben", NOON))
    assert lease(relay_database) == (7, ben, "ben", NOON, None)
    write(relay_database, LeaseEnd(sim1, 7, NOON + HOUR))
    write(relay_database, LeaseStart(sim1, 9, ben, "ben", NOON + HOUR))
    assert lease(relay_database) == (9, ben, "ben", NOON + HOUR, None)
    assert fence(relay_database, sim1, ben) == 10


def test_a_lease_that_is_written_late_or_again_leaves_the_newer(relay_database, sim1, ann, ben):
    """The answer to the first writing was lost; or another one's claim had the same number, and was lost."""
    fence(relay_database, sim1, ann, above=8)
    write(relay_database, LeaseEnd(sim1, 9, NOON + HOUR))
    write(relay_database, LeaseStart(sim1, 8, ben, "ben", NOON + HOUR))
    assert lease(relay_database) == (9, ann, "ann", NOON, NOON + HOUR)
    for _ in range(2):
        write(relay_database, LeaseStart(sim1, 9, ben, "ben", NOON + HOUR))
        assert lease(relay_database) == (9, ben, "ben", NOON + HOUR, None)


def test_a_lease_of_somebody_who_is_gone_keeps_its_number(relay_database, sim1, ann):
    """A robot that is gone gets none."""
    with pytest.raises(RecordRefusedError):
        fence(relay_database, 999, ann)
    write(relay_database, LeaseStart(sim1, 7, 999, "gone", NOON), LeaseStart(998, 1, 999, "", NOON))
    assert lease(relay_database) == (7, None, "gone", NOON, None)


def test_a_relay_finds_numbers_and_stops(relay_database, sim1, ann):
    """What outlives a relay is read in one go; the newest stop stays, until the release."""
    fence(relay_database, sim1, ann)
    stop = Stop(sim1, NOON, "ben", "smoke")
    write(relay_database, StopEntry(sim1, Stop(sim1, NOON - HOUR, "ann")), StopEntry(sim1, stop))
    with relay_database.transaction() as tx:
        found = control.read_stored(tx)
    assert (found.fences, found.stops) == ({sim1: 1}, [stop])
    with relay_database.transaction() as tx:
        assert control.read_stored(tx, sim1) == found
        assert control.read_stored(tx, sim1 + 1) == StoredControl({}, [])
    write(relay_database, StopEntry(sim1, ended=(stop.id,)))
    with relay_database.transaction() as tx:
        assert control.read_stored(tx).stops == []


def test_a_release_leaves_a_stop_that_another_cell_wrote(relay_database, sim1):
    stop = Stop(sim1, NOON, "ben")
    write(relay_database, StopEntry(sim1, stop))
    ended = ((NOON, "ann"), (NOON - HOUR, "ben"))
    write(relay_database, StopEntry(sim1, ended=ended))
    # That of a robot that was removed writes nothing.
    write(relay_database, StopEntry(999, Stop(999, NOON, "ben")))
    with relay_database.transaction() as tx:
        assert control.read_stored(tx).stops == [stop]


def test_a_drive_is_written_while_it_lasts_and_at_its_end(relay_database, sim1):
    drive = DriveEntry(sim1, "sim1", "ann", 3, NOON, "198.51.100.7")
    drive.row_id = write(relay_database, drive)[0]
    drive.distance_m, drive.refused, drive.stops = 2.5, {"topic": 1}, 1
    drive.ended_at, drive.end_code = NOON + HOUR, "client_left"
    drive.latency_p50_ms, drive.latency_p95_ms, drive.bytes = 41.2, 80.5, 1234
    drive.seen_p50_ms, drive.seen_p95_ms, drive.seen_p99_ms = 140.2, 210.5, 380.0
    drive.seen_max_ms, drive.seen_unknown, drive.slowed_s = 512.3, 4, 12.0
    drive.frames, drive.frame_bytes, drive.viewed_s = 30, 90_000, 2.5
    drive.turned_rad = drive.top_turn_rad_s = None
    drive.robot_key, drive.agent_version, drive.end_y_m = "SHA256:x", "0.2.0", -1.5
    write(relay_database, drive)
    (row,) = rows(relay_database, "drives")
    names = {"user": "user_name", "frames": "pictures", "frame_bytes": "picture_bytes"}
    written = vars(drive) | {"refused": '{"topic": 1}'}
    del written["row_id"]
    assert {name: row[names.get(name, name)] for name in written} == written


def test_a_drive_that_is_written_as_new_again_is_one_row_with_its_newest_figures(
    relay_database, sim1
):
    """The first writing got no answer."""
    first = write(relay_database, DriveEntry(sim1, "sim1", "ann", 3, NOON))
    again = DriveEntry(sim1, "sim1", "ann", 3, NOON, distance_m=2.5)
    again.ended_at, again.end_code = NOON + HOUR, "relay_restarted"
    assert write(relay_database, again, FormerSessions(NOON + 2 * HOUR)) == first
    (row,) = rows(relay_database, "drives")
    assert (row["distance_m"], row["end_code"], row["ended_at"]) == (
        2.5,
        "relay_restarted",
        NOON + HOUR,
    )


def test_a_drive_outlives_its_robot(database, relay_database, sim1):
    """Names stay in the record of a robot that is gone, also when it is written first after that."""
    drive = DriveEntry(sim1, "sim1", "ann", 3, NOON)
    drive.row_id = write(relay_database, drive)[0]
    with database.transaction() as tx:
        tx.change("DELETE FROM robots")
    write(relay_database, drive, DriveEntry(sim1, "sim1", "ann", 4, NOON))
    found = [(row["robot_id"], row["robot"]) for row in rows(relay_database, "drives")]
    assert found == [(None, "sim1")] * 2


def test_what_a_former_relay_left_open_is_ended(relay_database, sim1, ann):
    """Its drives end when they were last written, its leases now; newer ones stay open."""
    fence(relay_database, sim1, ann)
    write(
        relay_database,
        DriveEntry(sim1, "sim1", "ann", 1, NOON),
        DriveEntry(sim1, "sim1", "ann", 2, NOON + 2 * HOUR),
        FormerSessions(NOON + HOUR),
    )
    old, new = rows(relay_database, "drives")
    assert old["end_code"] == "relay_restarted"
    assert old["ended_at"] is not None
    assert new["ended_at"] is None
    assert rows(relay_database, "control_leases")[0]["ended_at"] is not None


def test_what_another_cell_left_open_stays(relay_database, sim1, ann):
    """Its own relay ends it, or its removal; a lease is of the cell that wrote it last."""
    with relay_database.transaction() as tx:
        fleet.write(tx, [LeaseStart(sim1, 1, ann, "ann", NOON)], "a")
        fleet.write(tx, [LeaseStart(sim1, 2, ann, "ann", NOON)], "b")
        fleet.write(tx, [DriveEntry(sim1, "sim1", "ann", 2, NOON)], "b")
        fleet.write(tx, [FormerSessions(NOON + HOUR)], "a")
    for table in ("drives", "control_leases"):
        (row,) = rows(relay_database, table)
        assert (row["cell"], row["ended_at"]) == ("b", None)

"""Drives as they are shown, and to whom."""

import datetime as dt

import pytest
from drive_records import add_drive
from granted import give
from relay_server import cell_settings
from robotether_server.db import cells, drives, robots, users
from robotether_server.db.drives import DriveSearch

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


@pytest.fixture(autouse=True)
def _people(database):
    """Ann manages a and drives b; ben drives both."""
    with database.transaction() as tx:
        ids = {name: users.add(tx, name, "x", "user") for name in ("ann", "ben")}
        users.add(tx, "root", "x", "admin")
        for number, name in enumerate("ab"):
            robot_id = robots.add(tx, f"02:00:00:00:00:0{number}", name)
            give(tx, ids["ann"], robot_id, "manage" if name == "a" else "drive")
            give(tx, ids["ben"], robot_id, "drive")


def seen_by(
    database,
    name,
    search=DriveSearch(),  # noqa: B008 - frozen
):
    with database.transaction() as tx:
        found = drives.find(tx, users.get(tx, name), search)
    return [(item.robot, item.user) for item in found]


def test_own_drives_and_those_of_managed_robots_are_shown(database, admin_database):
    """Admins see all, also of robots that are gone; the newest stands first."""
    for robot, user in (("gone", "ben"), ("a", "ben"), ("b", "ben"), ("b", "ann")):
        add_drive(admin_database, robot, user, fence=len(robot + user) + ord(user[0]))
    assert seen_by(database, "ann") == [("b", "ann"), ("a", "ben")]
    assert seen_by(database, "ben") == [("b", "ben"), ("a", "ben"), ("gone", "ben")]
    assert len(seen_by(database, "root")) == 4


def test_drives_of_a_robot_are_found_by_all_its_names(database, admin_database):
    """Each has the name of its time; the new name finds those too, of this robot alone."""
    add_drive(admin_database, "a", "ben", fence=1)
    with database.transaction() as tx:
        robot = robots.get(tx, "a")
        robots.rename(tx, robot.id, "c")
        robots.add(tx, "02:00:00:00:00:02", "a")
    add_drive(admin_database, "c", "ben", fence=2)
    add_drive(admin_database, "a", "ben", fence=3)
    assert seen_by(database, "root", DriveSearch(robot="c")) == [("c", "ben"), ("a", "ben")]
    assert len(seen_by(database, "root", DriveSearch(robot="a"))) == 2
    # The next user of a name does not see the drives of the one before.
    with database.transaction() as tx:
        users.remove(tx, users.get(tx, "ben").id)
        users.add(tx, "ben", "x", "user")
    assert seen_by(database, "ben") == []


def test_a_drive_that_never_moved_the_robot_is_found_by_its_number_alone(database, admin_database):
    """Who only took the control fills no list; one that only turned the robot moved it."""
    still = add_drive(admin_database, "a", "ann", fence=1, top_speed_m_s=0, distance_m=0)
    add_drive(admin_database, "b", "ann", fence=2, top_speed_m_s=0, distance_m=0, top_turn_rad_s=1)
    assert seen_by(database, "ann") == [("b", "ann")]
    assert seen_by(database, "ann", DriveSearch(robot="a")) == []
    assert seen_by(database, "ann", DriveSearch(robot="a", fence=1)) == [("a", "ann")]
    with database.transaction() as tx:
        assert drives.get(tx, users.get(tx, "ann"), still).fence == 1


def test_a_drive_of_a_dead_cell_has_ended(database, admin_database, relay_database):
    with relay_database.transaction() as tx:
        cells.write_heartbeat(tx, cell_settings("x"), cells.CellCounts(), NOON)
    changes = {"ended_at": None, "end_code": None, "updated_at": NOON, "cell": "x"}
    number = add_drive(admin_database, "a", "ann", **changes)

    def shown():
        with database.transaction() as tx:
            found = drives.get(tx, users.get(tx, "ann"), number)
        return found.ended_at, found.end_code

    assert shown() == (None, None)
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = %s", (NOON,))
    assert shown() == (NOON, "cell_removed")

"""The fleet as web and the command show it, from the real database."""

import datetime as dt

import pytest
from relay_server import cell_settings
from robotether_server.db import cells, control, fleet, robots, seen_robots, users
from robotether_server.db.control import NewLease
from robotether_server.db.fleet import SessionEntry
from robotether_server.db.robots import Report
from robotether_server.db.seen_robots import FREE, DrivenBy
from robotether_server.identity import PublicKey

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)
HOUR = dt.timedelta(hours=1)
MAC = "00:1b:44:11:3a:b7"
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:abc")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")


@pytest.fixture
def sim1(database, relay_database):
    """A robot of cell a, where ann has been driving it since noon."""
    with database.transaction() as tx:
        ann, robot_id = users.add(tx, "ann", "x", "user"), robots.add(tx, MAC, "sim1")
    with relay_database.transaction() as tx:
        for name in ("a", "b"):
            cells.write_heartbeat(tx, cell_settings(name), cells.CellCounts(), NOON)
        fleet.write(tx, [SessionEntry(robot_id, NOON, "192.0.2.1")], "a")
        control.next_fence(tx, NewLease(robot_id, ann, "ann", NOON), "a")
    with database.transaction() as tx:
        return robots.get(tx, "sim1")


def test_robot_of_a_dead_cell_is_offline(sim1, database, admin_database):
    with database.transaction() as tx:
        assert seen_robots.is_online(tx, sim1.id)
        assert seen_robots.control_of(tx, sim1.id).driver == DrivenBy("ann", NOON)
        (seen,) = seen_robots.list_all(tx)
        (session,) = seen_robots.sessions_of(tx, sim1.id, 2)
    assert (seen.online, seen.since, session.ended_at) == (True, NOON, None)
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = %s WHERE name = 'a'", (NOON + HOUR,))
    with database.transaction() as tx:
        assert not seen_robots.is_online(tx, sim1.id)
        assert seen_robots.control_of(tx, sim1.id) == FREE
        assert seen_robots.control_of_all(tx) == {}
        (seen,) = seen_robots.list_all(tx)
        (session,) = seen_robots.sessions_of(tx, sim1.id, 2)
    assert (seen.online, seen.since) == (False, NOON + HOUR)
    assert (session.ended_at, session.end_code) == (NOON + HOUR, "cell_removed")


def test_ended_session_that_is_written_late_hides_no_open_one(sim1, database, relay_database):
    """The robot went from b to a while b could not write."""
    left = SessionEntry(sim1.id, NOON - HOUR, "192.0.2.2", ended_at=NOON, end_code="cell_draining")
    with relay_database.transaction() as tx:
        fleet.write(tx, [left], "b")
    with database.transaction() as tx:
        assert seen_robots.is_online(tx, sim1.id)
        (seen,) = seen_robots.list_all(tx)
        assert cells.find_of_robot(tx, sim1.id).name == "a"
    assert (seen.online, seen.since, seen.address) == (True, NOON, "192.0.2.1")


def test_another_key_shows_on_web_and_at_the_relay(database, relay_database, sim1):
    said = []
    for act in (
        lambda _tx: None,
        lambda tx: robots.add_claim(tx, sim1, KEY, REPORT),
        lambda tx: robots.reject_claim(
            tx, robots.find_claim(tx, KEY.fingerprint).id, sim1.name, "root"
        ),
    ):
        with database.transaction() as tx:
            act(tx)
        with relay_database.transaction() as tx:
            snapshot = fleet.load(tx)
        said.append((snapshot.robots[sim1.id].other_key, snapshot.rights))
    assert [key for key, _ in said] == [None, "waiting", "rejected"]
    assert len({version for _, version in said}) == 3

"""The cells' rows in the real database, and which cell a robot connects to first."""

import datetime as dt
import itertools
from collections import Counter
from dataclasses import replace

import pytest
from relay_server import cell_settings
from robotether_server import __version__
from robotether_server.db import cells
from robotether_server.db.cells import (
    Cell,
    CellCounts,
    SshAddresses,
    find_choice,
    sort_for,
    sort_for_join,
)
from robotether_server.problems import RecordExistsError
from robotether_server.times import MAX_TICKET_AHEAD_S, MAX_TICKET_TTL_S

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)
MINUTE = dt.timedelta(minutes=1)
A = Cell("a", "a.example", 443, (2222, 443), "a.example:8444", "0.1.0", 0, False, True)
B, C = replace(A, name="b", host="b.example"), replace(A, name="c", host="c.example")


def heartbeat(database, cell, robots=0, started_at=NOON):
    with database.transaction() as tx:
        cells.write_heartbeat(tx, cell, CellCounts(robots), started_at)


def read(database):
    with database.transaction() as tx:
        return cells.read(tx)


def age(admin_database, seconds):
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = heartbeat_at - INTERVAL %s SECOND", (seconds,))


def hosts(robot_id, known, first=None, region=None):
    return [cell.host for cell in sort_for(robot_id, known, first, region=region)]


def test_a_heartbeat_makes_the_row_and_keeps_it_new(relay_database, database):
    """What the relay says of its cell is what all read; only an admin drains it."""
    heartbeat(relay_database, cell_settings("b"))
    heartbeat(relay_database, cell_settings("a", "a.example", "a.example:8444"), robots=2)
    with database.transaction() as tx:
        tx.change("UPDATE cells SET draining = TRUE WHERE name = 'a'")
    heartbeat(relay_database, cell_settings("a", "a.example", "a.example:8444", "eu"), robots=3)
    assert [replace(cell, clock_ahead_s=None) for cell in read(database)] == [
        replace(A, version=__version__, robots=3, draining=True, region="eu"),
        Cell("b", None, 443, (2222, 443), None, __version__, 0, False, True),
    ]


def test_a_cell_is_alive_for_5_seconds(relay_database, admin_database):
    heartbeat(relay_database, cell_settings("a"))
    age(admin_database, 4)
    assert read(relay_database)[0].is_alive
    age(admin_database, 2)
    assert not read(relay_database)[0].is_alive
    heartbeat(relay_database, cell_settings("a"))
    assert read(relay_database)[0].is_alive
    # The clock was set back since, and a relay that starts now is older than the one before it.
    age(admin_database, -3600)
    assert not read(relay_database)[0].is_alive
    heartbeat(relay_database, cell_settings("a"), started_at=NOON - MINUTE)
    assert read(relay_database)[0].is_alive


def test_of_two_relays_with_one_name_the_older_is_refused(relay_database, admin_database):
    """Two machines with the same CELL would overwrite each other's address, unless the other is gone."""
    older, newer = cell_settings("a", "old.example"), cell_settings("a", "new.example")
    heartbeat(relay_database, older)
    heartbeat(relay_database, newer, started_at=NOON + MINUTE)
    with pytest.raises(RecordExistsError, match="another relay has this name"):
        heartbeat(relay_database, older)
    assert read(relay_database)[0].host == "new.example"
    age(admin_database, 6)
    heartbeat(relay_database, older)
    assert read(relay_database)[0].host == "old.example"


DRAINING = {"draining": True}
STATES = (
    {},
    DRAINING,
    {"region": "eu"},
    DRAINING | {"region": "eu"},
    {"is_alive": False},
    {"host": None},
)


@pytest.mark.parametrize("states", [*itertools.product(STATES, repeat=3)])
def test_cells_come_by_drain_region_and_the_robots_own_order(states):
    """What takes no robots is not listed; each robot has an order of its own, whatever the sequence of the rows."""
    cells_of_site = zip((A, B, C), (2, 0, 1), states, strict=True)
    known = [replace(cell, robots=robots, **state) for cell, robots, state in cells_of_site]
    listed = [cell for cell in known if cell.is_alive and cell.host]
    in_service = [cell for cell in listed if not cell.draining]
    for robot_id in range(4):
        own = hosts(robot_id, [A, B, C])
        for first, region in itertools.product((None, "b"), (None, "eu")):
            key = {
                cell.host: (
                    cell.draining,
                    bool(region) and cell.region != region,
                    cell.name != first,
                    own.index(cell.host),
                )
                for cell in listed
            }
            expected = sorted(key, key=key.__getitem__)
            assert hosts(robot_id, known, first, region) == expected
            assert hosts(robot_id, known[::-1], first, region) == expected
        joins = [cell.host for cell in sort_for_join(robot_id, known, region="eu")]
        assert set(joins) == {cell.host for cell in listed}
        if in_service:
            near = [cell for cell in in_service if cell.region == "eu"] or in_service
            assert joins[0] == min(near, key=lambda cell: cell.robots).host


def test_robot_may_choose_among_cells_of_one_rank():
    """Region and drain come before distance, and so does where the server sends it."""
    eu, drained = replace(B, region="eu"), replace(C, draining=True)

    def ranks(**changes):
        known = sort_for(7, [A, eu, drained], "a", **changes)
        return {cell.host[0]: cell.rank for cell in known}

    assert ranks() == {"a": 0, "b": 0, "c": 1}
    assert ranks(region="eu") == {"b": 0, "a": 1, "c": 2}
    assert ranks(is_sent=True) == {"a": 0, "b": 1, "c": 2}


@pytest.mark.parametrize(
    ("change", "region", "name"),
    [
        ({}, None, "b"),
        ({"region": "eu"}, "eu", "b"),
        ({"region": "us"}, "eu", None),
        ({"draining": True}, None, None),
        ({"host": "c.example"}, None, None),
    ],
)
def test_robot_chooses_no_worse_cell(change, region, name):
    here = replace(A, region="eu")
    address = SshAddresses(B.host, B.ssh_ports, 5)
    choice = find_choice([here, replace(B, **change)], address, "a", region=region)
    assert (choice and choice.name) == name


def test_a_cell_that_goes_moves_its_own_robots_alone():
    before = {robot_id: hosts(robot_id, [A, B, C])[0] for robot_id in range(300)}
    after = {robot_id: hosts(robot_id, [A, B])[0] for robot_id in range(300)}
    moved = [robot_id for robot_id in before if before[robot_id] != after[robot_id]]
    assert {before[robot_id] for robot_id in moved} == {"c.example"}
    counts = Counter(after[robot_id] for robot_id in moved)
    assert min(counts.values()) > len(moved) / 4


def test_robots_that_join_are_spread_over_cells_with_as_few():
    joined = {sort_for_join(robot_id, [A, B, C])[0].host for robot_id in range(20)}
    assert joined == {"a.example", "b.example", "c.example"}


def test_the_clock_of_a_dead_cell_counts_until_its_tickets_expired(
    relay_database, admin_database, monkeypatch
):
    """A cell that has just died signed tickets that are still good; one that never returns delays no driver."""
    ahead = dt.timedelta(seconds=90)
    monkeypatch.setattr(cells, "utc_now", lambda: dt.datetime.now(dt.UTC) + ahead)
    for _ in range(2):
        heartbeat(relay_database, cell_settings("a"))
    assert read(relay_database)[0].clock_ahead_s == pytest.approx(90, abs=5)
    age(admin_database, MAX_TICKET_TTL_S)
    assert read(relay_database)[0].clock_ahead_s == pytest.approx(90, abs=5)
    age(admin_database, MAX_TICKET_AHEAD_S)
    assert read(relay_database)[0].clock_ahead_s is None

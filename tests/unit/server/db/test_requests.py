"""Requests for help in the real database, with the accounts of web and relay."""

import pytest
from robotether_server.db import fleet, robots
from robotether_server.db.fleet import HelpEntry

MARKUP = "<img src=x onerror=alert(1)>"


@pytest.fixture
def sim1(database):
    with database.transaction() as tx:
        robot_id = robots.add(tx, "00:1b:44:11:3a:b1", "sim1")
        robots.set_state(tx, robot_id, "active")
    return robot_id


@pytest.fixture
def ask(relay_database, sim1):
    """Ask as a robot does; return the id of the request, and whether it is new."""

    def ask(source="robot", reason="stuck", priority=2, pool="", robot_id=sim1):
        with relay_database.transaction() as tx:
            return fleet.ask_for_help(
                tx, robot_id, source=source, reason=reason, priority=priority, pool=pool
            )

    return ask


def rows(database, sql="SELECT * FROM help_requests ORDER BY id"):
    with database.transaction() as tx:
        return tx.rows(sql)


def test_flood_by_a_robot_is_bounded(database, ask):
    """Four requests are open at most, one of a source; the first reason and the most urgent priority stay."""
    sources = ("robot", "stop", "battery", "diagnostics", "geofence", "navigation")
    answers = [ask(source, f"{number}", 3) for number in range(20) for source in sources]
    assert [is_new for _, is_new in answers] == [True] * 4 + [False] * 116
    assert {request_id is None for request_id, _ in answers[4:6]} == {True}
    assert ask("stop", "urgent", 1) == (answers[1][0], False)
    assert ask("stop", "low", 3) == (answers[1][0], False)
    found = rows(database)
    assert [(row["source"], row["reason"], row["priority"]) for row in found] == [
        ("robot", "0", 3),
        ("stop", "0", 1),
        ("battery", "0", 3),
        ("diagnostics", "0", 3),
    ]
    lines = rows(database, "SELECT kind, details FROM audit_events WHERE kind LIKE 'request%%'")
    assert [line["kind"] for line in lines] == ["request_made"] * 4 + ["request_raised"]
    assert '"reason": "urgent"' in lines[4]["details"]


def test_nothing_that_a_robot_says_makes_its_request_fail(database, ask, sim1):
    """A person's source, a pool that nobody can have and texts of any length are cut down, and markup stays data."""
    ask("page", MARKUP + "\n\0" + "x" * 5000, -7, "No Pool")
    (row,) = rows(database)
    assert row["source"] == "robot"
    assert row["reason"] == (MARKUP + "  " + "x" * 5000)[:200]
    assert (row["priority"], row["pool"], row["asked_by"]) == (1, "", "sim1")
    ask("stop", "", 99, "p" * 63)
    assert [(row["priority"], row["pool"]) for row in rows(database)][1] == (3, "p" * 63)
    # A robot that is not active asks in vain.
    with database.transaction() as tx:
        robots.set_state(tx, sim1, "disabled")
    for robot_id in (sim1, sim1 + 1):
        assert ask("battery", robot_id=robot_id) == (None, False)


def test_what_a_relay_writes_later_asks_for_help_as_well(database, relay_database, sim1):
    """That of a robot that is gone is left out, and what comes with it is written."""
    entries = [HelpEntry(999_999, "robot", "gone", 1), HelpEntry(sim1, "stop", "by ben", 2)]
    with relay_database.transaction() as tx:
        fleet.write(tx, entries)
    assert [(row["source"], row["reason"]) for row in rows(database)] == [("stop", "by ben")]

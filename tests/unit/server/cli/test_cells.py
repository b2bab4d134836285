"""robotether cell ..."""

import datetime as dt
import json

import pytest
from relay_server import cell_settings
from robotether_server import __version__
from robotether_server.db import cells

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)


def heartbeat(relay_database, name, robots):
    host = None if name == "c" else f"{name}.example"
    with relay_database.transaction() as tx:
        cell = cell_settings(name, host, region="eu" if name == "b" else None)
        cells.write_heartbeat(tx, cell, cells.CellCounts(robots), NOON)


@pytest.fixture(autouse=True)
def _cells(relay_database, admin_database):
    """Cells a and b, and c, which is down and had robots."""
    for name, robots in (("a", 2), ("b", 0), ("c", 3)):
        heartbeat(relay_database, name, robots)
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = %s WHERE name = 'c'", (NOON,))


def test_cells_are_listed(run):
    assert run("cell", "drain", "b").out == "cell b is draining\n"
    assert [line.split() for line in run("cell", "list").out.splitlines()] == [
        ["NAME", "HOST", "REGION", "ROBOTS", "VERSION", "STATE"],
        ["a", "a.example", "-", "2", __version__, "alive"],
        ["b", "b.example", "eu", "0", __version__, "draining"],
        ["c", "-", "-", "0", __version__, "down"],
    ]
    shown = json.loads(run("cell", "list", "--json").out)
    assert [item["is_alive"] for item in shown] == [True, True, False]
    assert run("cell", "resume", "b").out == "cell b is in service\n"
    assert run("cell", "list").out.splitlines()[2].split()[-1] == "alive"


def test_drain_waits_until_the_robots_have_left(run, relay_database):
    done = run("cell", "drain", "a", "--wait", "--timeout", "0.1")
    assert (done.status, done.err) == (
        1,
        "robotether: cannot see cell a empty after 0.1 s: 2 robots are left\n",
    )
    heartbeat(relay_database, "a", 0)
    for name in ("a", "c"):
        assert run("cell", "drain", name, "--wait").out == f"cell {name} is empty\n"


def test_removal_wants_a_yes(run):
    assert "say --yes" in run("cell", "remove", "c").err
    assert run("cell", "remove", "c", "--yes").out == "removed cell c\n"
    assert "it is alive" in run("cell", "remove", "b", "--yes").err

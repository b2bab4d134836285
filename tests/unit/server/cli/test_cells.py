"""robotether cell ..."""

import datetime as dt
import json

from relay_server import cell_settings
from robotether_server.db import cells

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)


def heartbeat(relay_database, name, robots):
    with relay_database.transaction() as tx:
        cells.write_heartbeat(
            tx, cell_settings(name, f"{name}.example"), cells.CellCounts(robots), NOON
        )


def test_drain_waits_until_the_robots_have_left(run, relay_database, admin_database):
    """Robots of a machine that is down are unknown: it may have lost the database alone, while people drive there."""
    for name, robots in (("a", 2), ("b", 0), ("c", 3)):
        heartbeat(relay_database, name, robots)
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = %s WHERE name = 'c'", (NOON,))
    done = run("cell", "drain", "a", "--wait", "--timeout", "0.1")
    said = "robotether: cannot see cell a empty after 0.1 s: 2 robots are left\n"
    assert (done.status, done.err) == (1, said)
    heartbeat(relay_database, "a", 0)
    assert run("cell", "drain", "a", "--wait").out == "cell a is empty\n"
    done = run("cell", "drain", "c", "--wait")
    assert done.status == 1
    assert "it is down, and nobody knows whether" in done.err
    robots = {
        cell["name"]: cell["robots"] for cell in json.loads(run("cell", "list", "--json").out)
    }
    assert robots == {"a": 0, "b": 0, "c": None}
    assert " unknown " in run("cell", "list").out
    assert run("cell", "resume", "a").out == "cell a is in service\n"
    assert "it is alive" in run("cell", "remove", "b", "--yes").err
    assert run("cell", "remove", "c", "--yes").out == "removed cell c\n"

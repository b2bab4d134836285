"""Who drives and what is stopped, as the relay wrote it."""

from __future__ import annotations

import datetime as dt

from robotether_server.db import Database, control_states, robots
from robotether_server.db.control_states import FREE, ControlState, DrivenBy, Stopped

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


def test_driver_and_stop_are_shown(database: Database, admin_database: Database) -> None:
    """A lease that has ended has no driver, and a robot without either is in no list."""
    with admin_database.transaction() as tx:
        one, two, three = (robots.add(tx, f"02:00:00:00:00:0{n}", f"r{n}") for n in (1, 2, 3))
        tx.change(
            "INSERT INTO control_leases (robot_id, fence, user_name, since, ended_at) "
            "VALUES (%s, 3, 'ann', %s, NULL), (%s, 4, 'ben', %s, CURRENT_TIMESTAMP(6))",
            (one, NOON, two, NOON),
        )
        tx.change(
            "INSERT INTO robot_stops (robot_id, by_name, stopped_at) VALUES (%s, 'zoe', %s)",
            (two, NOON),
        )
    driven, stopped = (
        ControlState(driver=DrivenBy("ann", NOON)),
        ControlState(stopped=Stopped("zoe", NOON)),
    )
    with database.transaction() as tx:
        assert control_states.of_robot(tx, one) == driven
        assert control_states.of_robot(tx, two) == stopped
        assert control_states.of_robot(tx, three) == FREE
        assert control_states.of_all(tx) == {one: driven, two: stopped}

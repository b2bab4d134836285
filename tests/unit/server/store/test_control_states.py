"""Who drives and what is stopped, as the relay wrote it."""

from __future__ import annotations

from robotether_server.store import Database, control_states, robots
from robotether_server.store.control_states import ControlState


def test_driver_and_stop_are_shown(database: Database, admin_database: Database) -> None:
    """A lease that has ended has no driver."""
    with admin_database.transaction() as tx:
        one, two = (robots.add(tx, f"02:00:00:00:00:0{n}", f"r{n}") for n in (1, 2))
        tx.change(
            "INSERT INTO control_leases (robot_id, fence, user_name, ended_at) "
            "VALUES (%s, 3, 'ann', NULL), (%s, 4, 'ben', CURRENT_TIMESTAMP(6))",
            (one, two),
        )
        tx.change("INSERT INTO robot_stops (robot_id, by_name) VALUES (%s, 'zoe')", (two,))
    with database.transaction() as tx:
        assert control_states.of_robot(tx, one) == ControlState(driver="ann")
        assert control_states.of_robot(tx, two) == ControlState(stopped_by="zoe")
        assert control_states.stopped(tx) == {two: "zoe"}

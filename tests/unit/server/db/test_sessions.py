"""Robots' sessions, the newest first."""

from __future__ import annotations

from robotether_server.db import Database, robots, sessions


def test_sessions_are_told_newest_first(database: Database, admin_database: Database) -> None:
    """As many as were asked for; a robot whose newest goes on is online."""
    with database.transaction() as tx:
        robot_id = robots.add(tx, "00:1b:44:11:3a:b7", "a")
        assert not sessions.is_online(tx, robot_id)
    with admin_database.transaction() as tx:
        for address, ended in (
            ("192.0.2.1", "NOW(6)"),
            ("192.0.2.2", "NOW(6)"),
            ("192.0.2.3", "NULL"),
        ):
            tx.change(
                "INSERT INTO robot_sessions (robot_id, address, agent_version, end_code, ended_at) "
                f"VALUES (%s, %s, '0.1', 'timeout', {ended})",
                (robot_id, address),
            )
    with database.transaction() as tx:
        found = sessions.of_robot(tx, robot_id, 2)
        assert sessions.is_online(tx, robot_id)
    assert [one.address for one in found] == ["192.0.2.3", "192.0.2.2"]
    older = found[1]
    assert older.ended_at is not None
    assert older.started_at <= older.ended_at
    assert (older.end_code, older.agent_version) == ("timeout", "0.1")

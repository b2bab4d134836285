"""MACs of robots, and who has which ports."""

from __future__ import annotations

from robotether_server.db import Database


def mac(number: int) -> str:
    return f"02:00:00:00:{number >> 8:02x}:{number & 255:02x}"


def pair_owners(admin_database: Database) -> dict[int, int]:
    """ROS port -> robot, of the pairs that are in use."""
    with admin_database.transaction() as tx:
        rows = tx.rows("SELECT ros_port, robot_id FROM port_pairs WHERE robot_id IS NOT NULL")
    return {row["ros_port"]: row["robot_id"] for row in rows}

"""The ranges of ports that robots and their shells are allotted from; only `migrate` writes them.

The allotment itself is in the database (sql/0002_ports_and_macs.sql, 0006), so that a plain INSERT works.
"""

from robotether_server.db.database import Transaction


def set_range(tx: Transaction, first: int, last: int) -> None:
    """Make the pairs `first`, `first` + 2, ... up to `last` the ones to allot from.

    Pairs in use stay, even outside the range; so do the ports of every robot.
    """
    tx.change(
        "DELETE FROM port_pairs WHERE robot_id IS NULL "
        "AND (ros_port < %s OR video_port > %s OR MOD(ros_port + %s, 2) = 1)",
        (first, last, first),
    )
    tx.change_many(
        "INSERT IGNORE INTO port_pairs (ros_port) VALUES (%s)",
        [(ros_port,) for ros_port in range(first, last, 2)],
    )
    # A robot may have been given ports by hand, or a shell, where there were no pairs until now.
    tx.change(
        "UPDATE port_pairs p JOIN robots r ON r.ros_port IN (p.ros_port, p.video_port) "
        "OR r.video_port IN (p.ros_port, p.video_port) "
        "OR r.shell_port IN (p.ros_port, p.video_port) "
        "SET p.robot_id = r.id WHERE p.robot_id IS NULL"
    )


def set_shell_range(tx: Transaction, first: int, last: int) -> None:
    """Make the ports `first` to `last` the ones to allot to shells.

    Ports in use stay, even outside the range; a port that a robot was given by hand for ROS or video is left out.
    """
    tx.change(
        "DELETE FROM shell_ports WHERE robot_id IS NULL AND NOT port BETWEEN %s AND %s",
        (first, last),
    )
    rows = tx.rows("SELECT ros_port, video_port FROM robots")
    taken = {row[column] for row in rows for column in ("ros_port", "video_port")}
    tx.change_many(
        "INSERT IGNORE INTO shell_ports (port) VALUES (%s)",
        [(port,) for port in range(first, last + 1) if port not in taken],
    )

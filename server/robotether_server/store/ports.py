"""The range of ports that robots are allotted from; only `migrate` writes it.

The allotment itself is in the database (sql/0002_ports_and_macs.sql), so that a plain INSERT works.
"""

from robotether_server.store.database import Transaction


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
    # A robot may have been given ports by hand, where there were no pairs until now.
    tx.change(
        "UPDATE port_pairs p JOIN robots r ON r.ros_port IN (p.ros_port, p.video_port) "
        "OR r.video_port IN (p.ros_port, p.video_port) "
        "SET p.robot_id = r.id WHERE p.robot_id IS NULL"
    )

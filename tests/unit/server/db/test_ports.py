"""The range of ports: set again and again, wider and narrower, without touching a robot's ports."""

from __future__ import annotations

from robotether_server.db import Database, ports, robots


def pairs(admin_database: Database) -> list[int]:
    with admin_database.transaction() as tx:
        return [row["ros_port"] for row in tx.rows("SELECT * FROM port_pairs ORDER BY ros_port")]


def set_range(admin_database: Database, first: int, last: int) -> list[int]:
    with admin_database.transaction() as tx:
        ports.set_range(tx, first, last)
    return pairs(admin_database)


def test_range_is_made_of_whole_pairs(admin_database: Database) -> None:
    """An odd port at the end belongs to no pair; a second run changes nothing."""
    assert set_range(admin_database, 20000, 20005) == [20000, 20002, 20004]
    assert set_range(admin_database, 20000, 20004) == [20000, 20002]
    assert set_range(admin_database, 20000, 20004) == [20000, 20002]


def test_used_pair_outside_the_new_range_stays(
    database: Database, admin_database: Database
) -> None:
    """The robot keeps its ports; free pairs out of range go."""
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:01", "a")
    assert set_range(admin_database, 30000, 30003) == [20000, 30000, 30002]
    with database.transaction() as tx:
        assert robots.get(tx, "a").ros_port == 20000


def test_pair_that_somebody_has_by_hand_is_not_allotted(
    database: Database, admin_database: Database
) -> None:
    """A range that grows over a robot's own choice of ports leaves them to it."""
    with database.transaction() as tx:
        tx.insert(
            "INSERT INTO robots (mac, name, ros_port, video_port) "
            "VALUES ('02:00:00:00:00:01', 'a', 30001, 30002)"
        )
    set_range(admin_database, 30000, 30005)
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:02", "b")
        assert robots.get(tx, "b").ros_port == 30004


def test_range_that_moves_by_one_overlaps_nobody(
    database: Database, admin_database: Database
) -> None:
    """A pair of the old count that is in use blocks both new pairs that it touches."""
    set_range(admin_database, 20000, 20007)
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:01", "a")
    assert set_range(admin_database, 19999, 20006) == [19999, 20000, 20001, 20003, 20005]
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:02", "b")
        assert robots.get(tx, "b").ros_port == 20003


def shell_ports(admin_database: Database, first: int, last: int) -> list[int]:
    with admin_database.transaction() as tx:
        ports.set_shell_range(tx, first, last)
        return [row["port"] for row in tx.rows("SELECT port FROM shell_ports ORDER BY port")]


def test_shell_range_keeps_what_is_in_use(database: Database, admin_database: Database) -> None:
    """A second run changes nothing; a robot keeps its port when the range moves away."""
    assert shell_ports(admin_database, 24000, 24002) == [24000, 24001, 24002]
    assert shell_ports(admin_database, 24000, 24002) == [24000, 24001, 24002]
    with database.transaction() as tx:
        robots.set_shell(tx, robots.add(tx, "02:00:00:00:00:01", "a"), on=True)
    assert shell_ports(admin_database, 30000, 30001) == [24000, 30000, 30001]
    with database.transaction() as tx:
        assert robots.get(tx, "a").shell_port == 24000


def test_ranges_that_move_onto_each_other_share_no_port(
    database: Database, admin_database: Database
) -> None:
    """A port by hand is left out of the shells', and a shell's port is in no pair that is allotted."""
    with database.transaction() as tx:
        robots.set_ports(tx, robots.add(tx, "02:00:00:00:00:01", "a"), 30001, 30003)
        robots.set_shell(tx, robots.add(tx, "02:00:00:00:00:02", "b"), on=True)
    assert shell_ports(admin_database, 30000, 30003) == [24000, 30000, 30002]
    set_range(admin_database, 24000, 24003)
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:03", "c")
        assert robots.get(tx, "c").ros_port == 24002

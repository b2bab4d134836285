"""Ports that the database allots: pairs for ROS and video, and shell ports, in many transactions at once."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from allotment import mac, pair_owners
from robotether_server.db import migrate, robots, seen_robots
from robotether_server.problems import RecordExistsError, RecordRefusedError


@pytest.fixture
def purged(mariadb, admin_database):
    """No trace of the rows that an earlier test deleted.

    InnoDB locks the gap beside a deleted key, until it is purged, for whoever inserts the same key again: a
    short wait in real life, a deadlock with a barrier that holds every transaction open.
    """
    mariadb.as_root("SET GLOBAL innodb_max_purge_lag_wait = 0")


def shell_owners(admin_database):
    """Shell port -> robot, of those that are in use."""
    with admin_database.transaction() as tx:
        rows = tx.rows("SELECT port, robot_id FROM shell_ports WHERE robot_id IS NOT NULL")
    return {row["port"]: row["robot_id"] for row in rows}


def at_once(database, count, action):
    """Do something in as many threads, all inside their transactions at the same time."""
    together = threading.Barrier(count)

    def run(number):
        with database.transaction() as tx:
            together.wait(20)
            action(tx, number)

    with ThreadPoolExecutor(count) as threads:
        list(threads.map(run, range(count)))


@pytest.mark.usefixtures("purged")
def test_forty_inserts_at_once_get_distinct_pairs(database, admin_database):
    """Concurrent transactions neither share a pair nor fail, and none waits for another's commit."""
    inserted = threading.Barrier(40)

    def insert(tx, number):
        robots.add(tx, mac(number), f"robot-{number}")
        inserted.wait(20)

    at_once(database, 40, insert)
    owners = pair_owners(admin_database)
    assert len(owners) == 40
    with database.transaction() as tx:
        assert {r.robot.ros_port: r.robot.id for r in seen_robots.list_all(tx)} == owners


def test_last_pair_waits_for_the_one_who_holds_it(database, admin_database):
    """When every free pair is locked, an insert waits, and gets the pair if the holder gives up."""
    with admin_database.transaction() as tx:
        migrate.set_port_range(tx, 20000, 20001)
    waiting = []

    def insert_second():
        with database.transaction() as tx:
            waiting.append(robots.add(tx, mac(2), "second"))

    second = threading.Thread(target=insert_second)

    def insert_first_and_give_up():
        with database.transaction() as tx:
            robots.add(tx, mac(1), "first")
            second.start()
            second.join(0.5)
            assert waiting == []
            raise LookupError

    with pytest.raises(LookupError):
        insert_first_and_give_up()
    second.join(20)
    assert list(pair_owners(admin_database).values()) == waiting


def add_with_shell(tx, number):
    return tx.insert(
        "INSERT INTO robots (mac, name, shell) VALUES (%s, %s, TRUE)", (mac(number), f"r{number}")
    )


def test_shell_port_comes_and_goes_with_the_setting(database, admin_database):
    """A robot has none at first; off frees it, and so does the robot's end."""
    with database.transaction() as tx:
        plain, other = robots.add(tx, mac(1), "a"), add_with_shell(tx, 2)
        assert robots.get(tx, "a").shell_port is None
        robots.set_shell(tx, plain, on=True)
        assert (robots.get(tx, "a").shell_port, robots.get(tx, "r2").shell_port) == (24001, 24000)
        robots.rename(tx, plain, "b")
        assert robots.get(tx, "b").shell_port == 24001
        robots.set_shell(tx, other, on=False)
        assert robots.get(tx, "r2").shell_port is None
    assert shell_owners(admin_database) == {24001: plain}
    # One that an admin names is kept.
    with database.transaction() as tx:
        for port in (24010, 24011):
            tx.change("UPDATE robots SET shell_port = %s WHERE name = 'b'", (port,))
    assert shell_owners(admin_database) == {24011: plain}
    with database.transaction() as tx:
        tx.change("UPDATE robots SET shell = FALSE, shell_port = 24012 WHERE name = 'b'")
        assert robots.get(tx, "b").shell_port is None
        robots.set_shell(tx, plain, on=True)
        robots.remove(tx, plain)
    assert shell_owners(admin_database) == {}


@pytest.mark.usefixtures("purged")
def test_shells_switched_on_at_once_get_distinct_ports(database, admin_database):
    """None waits for another's commit."""
    with database.transaction() as tx:
        ids = [robots.add(tx, mac(number), f"r{number}") for number in range(20)]
    done = threading.Barrier(20)

    def switch_on(tx, number):
        robots.set_shell(tx, ids[number], on=True)
        done.wait(20)

    at_once(database, 20, switch_on)
    assert sorted(shell_owners(admin_database).values()) == sorted(ids)


def test_full_ranges_say_what_to_do(database, admin_database):
    with admin_database.transaction() as tx:
        migrate.set_port_range(tx, 20000, 20003)
        migrate.set_shell_port_range(tx, 24000, 24000)
    with database.transaction() as tx:
        add_with_shell(tx, 1)
        second = robots.add(tx, mac(2), "b")
        for action, why in (
            (
                lambda: robots.add(tx, mac(3), "c"),
                "add robot c: all 2 port pairs are in use; widen PORT_RANGE_FIRST..PORT_RANGE_LAST",
            ),
            (
                lambda: robots.set_shell(tx, second, on=True),
                "change robot b: all 1 shell ports are in use; widen SHELL_PORT_FIRST..SHELL_PORT_LAST",
            ),
        ):
            with pytest.raises(RecordRefusedError) as refused:
                action()
            assert refused.value.detail == f"cannot {why} in .env, then run migrate"
        assert robots.get(tx, "b").shell is False


def test_ports_kept_for_shells_are_nobodys_pair(database):
    with database.transaction() as tx:
        add_with_shell(tx, 1)
        robots.add(tx, mac(2), "b")
        for port in (24000, 23999, 80):
            with pytest.raises(
                (RecordExistsError, RecordRefusedError), match=r"no free shell port|exists already"
            ):
                tx.change(f"UPDATE robots SET shell = TRUE, shell_port = {port} WHERE name = 'b'")
        for ros, video in ((24000, 30000), (30000, 24049)):
            with pytest.raises(RecordRefusedError, match="is kept for shells"):
                tx.change(
                    "UPDATE robots SET ros_port = %s, video_port = %s WHERE name = 'b'",
                    (ros, video),
                )

"""Who has which ports, and inserts of many robots at the same moment, for tests of the database's allotment."""

from __future__ import annotations

import threading
from collections.abc import Callable

from robotether_server.db import Database, Transaction, robots
from robotether_server.problems import RobotetherError


def mac(number: int) -> str:
    return f"02:00:00:00:{number >> 8:02x}:{number & 255:02x}"


def pair_owners(admin_database: Database) -> dict[int, int]:
    """ROS port -> robot, of the pairs that are in use."""
    with admin_database.transaction() as tx:
        rows = tx.rows("SELECT ros_port, robot_id FROM port_pairs WHERE robot_id IS NOT NULL")
    return {row["ros_port"]: row["robot_id"] for row in rows}


def shell_owners(admin_database: Database) -> dict[int, int]:
    """Shell port -> robot, of those that are in use."""
    with admin_database.transaction() as tx:
        rows = tx.rows("SELECT port, robot_id FROM shell_ports WHERE robot_id IS NOT NULL")
    return {row["port"]: row["robot_id"] for row in rows}


def at_once(
    database: Database, count: int, action: Callable[[Transaction, int], object]
) -> list[str]:
    """Do something in as many threads, all inside their transactions at the same time; return what failed."""
    together = threading.Barrier(count)
    failures: list[str] = []

    def run(number: int) -> None:
        try:
            with database.transaction() as tx:
                together.wait(20)
                action(tx, number)
        except (LookupError, RobotetherError, threading.BrokenBarrierError) as error:
            failures.append(f"{type(error).__name__}: {error.__cause__ or error}")

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    return failures


def insert_at_once(
    database: Database, names: list[str], then: Callable[[int], object]
) -> list[str]:

    def insert(tx: Transaction, number: int) -> None:
        robots.add(tx, mac(number), names[number])
        then(number)

    return at_once(database, len(names), insert)

"""What tests of the command `robotether` put into the database, and ask it afterwards."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from robotether_server.db import Database, robots
from robotether_server.db.robots import Report, RobotRow
from robotether_server.identity import PublicKey

MAC = "02:00:00:00:51:01"
ADD = ("robot", "add", "sim1", "--mac", "0200.0000.5101", "--allow-local-mac")
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:abc")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:other")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")
OTHER_REPORT = Report("copy", "0.1.0", "192.0.2.2")


class Done(NamedTuple):
    status: int
    out: str
    err: str


# Runs `robotether` with these arguments.
Run = Callable[..., Done]


def show_key(database: Database, key: PublicKey = KEY) -> None:
    with database.transaction() as tx:
        robots.set_key(tx, robots.get(tx, "sim1").id, key, REPORT)


def activate(database: Database) -> None:
    show_key(database)
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "sim1").id, "active")


def claim(database: Database, key: PublicKey = OTHER_KEY) -> None:
    """Let somebody else join with sim1's MAC."""
    with database.transaction() as tx:
        robots.add_claim(tx, robots.get(tx, "sim1"), key, OTHER_REPORT)


def robot(database: Database, name: str = "sim1") -> RobotRow:
    with database.transaction() as tx:
        return robots.get(tx, name)


def events(database: Database) -> list[tuple[str, str, str]]:
    with database.transaction() as tx:
        rows = tx.rows("SELECT actor, kind, robot FROM audit_events ORDER BY id")
    return [(row["actor"], row["kind"], row["robot"]) for row in rows]


def kinds(database: Database) -> list[str]:
    return [kind for _, kind, _ in events(database)]

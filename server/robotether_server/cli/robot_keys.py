"""robotether robot approve, reject, rekey, rotate-key, and rejected ...: robots' keys.

A key counts for nothing until a person has compared it: approve and reject name the key that was looked at, and do
nothing when another has come in its place.
"""

import click

from robotether_server.cli import robot_texts
from robotether_server.cli.common import (
    SOURCE,
    NotDoneError,
    add_list,
    agree,
    open_database,
    print_fields,
    timestamp,
    wait_for,
)
from robotether_server.db import Database
from robotether_server.db import robots as db_robots
from robotether_server.db.robots import PendingKey, RobotRow
from robotether_server.services import pending, robots

COMPARE = "compare it with the one that robotether-agent status shows on the robot"


@click.command()
@click.argument("name")
@click.option(
    "--wait-for-key", type=float, default=0, metavar="SECONDS", help="Wait until it has joined."
)
@click.option(
    "--fingerprint",
    metavar="SHA256:...",
    help="Approve only this key, without asking; `robotether-agent status` on the robot shows it.",
)
@click.option(
    "--yes", is_flag=True, help="Approve the key that waits, whichever it is, without asking."
)
def approve(name: str, wait_for_key: float, fingerprint: str | None, yes: bool) -> None:
    """Approve a robot: the key that it showed is its own.

    The key replaces one that the robot had. Anybody who knows the robot's MAC can join in its name, so
    compare the key first.
    """
    database = open_database()
    wait_for(lambda: _has_shown_a_key(database, name), wait_for_key)
    chosen = fingerprint or _choose(database, name, yes=yes)
    with database.transaction() as tx:
        # What was compared is what is approved, whatever happened meanwhile.
        robots.approve(tx, SOURCE, name, chosen)
    click.echo(f"robot {name} is active with key {chosen}")


@click.command()
@click.argument("name")
@click.option("--fingerprint", metavar="SHA256:...", help="Reject this key, without asking.")
def reject(name: str, fingerprint: str | None) -> None:
    """Reject a waiting key, for good.

    This also removes a robot that nobody had added. To undo it: robotether rejected forgive.
    """
    database = open_database()
    chosen = fingerprint
    if chosen is None:
        robot, waiting = _find(database, name)
        key = _only(waiting, robot, "reject")
        print_fields(robot_texts.waiting_identity(key, robot))
        agree(f"reject {name}", "Reject this key?", f"say --fingerprint {key.fingerprint}")
        chosen = key.fingerprint
    with database.transaction() as tx:
        robots.reject(tx, SOURCE, name, chosen)
    click.echo(f"rejected key {chosen} of robot {name}")


@click.command()
@click.argument("name")
def rekey(name: str) -> None:
    """Forget a robot's key, and end its connection.

    The next key that joins waits for approval. For a robot that got a new disk, and against somebody who joined
    in its name. Its ports and grants stay.
    """
    database = open_database()
    with database.transaction() as tx:
        had = db_robots.get(tx, name).fingerprint
        robots.rekey(tx, SOURCE, name)
    click.echo(f"robot {name} has no key now; it had {had or 'none'}")


@click.command("rotate-key")
@click.argument("name")
def rotate_key(name: str) -> None:
    """Ask a robot's agent to make a new key.

    Its connections stay open. Afterwards the old key opens nothing.
    """
    with open_database().transaction() as tx:
        robots.rotate_key(tx, SOURCE, name)
    click.echo(f"robot {name} makes a new key as soon as it is online")


def _find(database: Database, name: str) -> tuple[RobotRow, list[PendingKey]]:
    with database.transaction() as tx:
        robot = db_robots.get(tx, name)
        return robot, [key for key in db_robots.list_waiting(tx) if key.robot == name]


def _has_shown_a_key(database: Database, name: str) -> bool | None:
    robot, waiting = _find(database, name)
    return bool(robot.fingerprint or waiting) or None


def _choose(database: Database, name: str, *, yes: bool) -> str:
    """Return the key that is to be approved; ask, unless `yes`."""
    robot, waiting = _find(database, name)
    if not waiting and robot.state == "active" and robot.fingerprint:
        return robot.fingerprint
    robots.check_not_disabled(robot)
    key = _only(waiting, robot, "approve")
    if not yes:
        print_fields(robot_texts.waiting_identity(key, robot))
        agree(
            f"approve robot {name}",
            "Does robotether-agent status on the robot show this very key?",
            f"take the key {key.fingerprint}, {COMPARE}, and give that one with --fingerprint",
        )
    return key.fingerprint


def _only(waiting: list[PendingKey], robot: RobotRow, action: str) -> PendingKey:
    if not waiting:
        joined = "no key waits there" if robot.fingerprint else "it has not joined yet"
        raise NotDoneError(
            f"cannot {action} robot {robot.name}: {joined}, so there is no key to {action}"
        )
    if len(waiting) > 1:
        keys = ", ".join(f"{key.fingerprint} from {key.address}" for key in waiting)
        raise NotDoneError(
            f"cannot decide which key to {action} for robot {robot.name}: {keys} wait; say --fingerprint"
        )
    return waiting[0]


@click.group()
def rejected() -> None:
    """List rejected keys, or let them join again."""


add_list(
    rejected,
    "List rejected keys, newest first.",
    db_robots.list_rejected_keys,
    ("ID", "ROBOT", "MAC", "HOST NAME", "ADDRESS", "REJECTED", "BY", "KEY"),
    lambda key: (
        str(key.id),
        key.robot,
        key.mac,
        key.hostname,
        key.address,
        timestamp(key.rejected_at, ""),
        key.rejected_by,
        key.fingerprint,
    ),
)


@rejected.command()
@click.argument("rejected_id", metavar="ID", type=int)
def forgive(rejected_id: int) -> None:
    """Forget a rejection; the key may join again, and waits for approval."""
    with open_database().transaction() as tx:
        forgiven = pending.forgive(tx, SOURCE, rejected_id)
    click.echo(f"key {forgiven.fingerprint} may ask again")

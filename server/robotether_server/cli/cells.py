"""robotether cell ...: the machines of the site, and which of them are out of service."""

import click

from robotether_server.cli.common import (
    SOURCE,
    YES,
    NotDoneError,
    add_list,
    open_database,
    remove_after_question,
    wait_for,
)
from robotether_server.db import Database, cells
from robotether_server.db.cells import Cell
from robotether_server.services import cells as cell_service


def _state(cell: Cell) -> str:
    if not cell.is_alive:
        return "down"
    return "draining" if cell.draining else "alive"


def _robots(cell: Cell) -> int | None:
    """Return how many are online there; None: unknown, as its relay may have lost the database and nothing else."""
    return cell.robots if cell.is_alive else None


@click.group()
def cell() -> None:
    """List the machines of the site; take one out of service and back."""


add_list(
    cell,
    "List the machines with their robots.",
    cells.read,
    ("NAME", "HOST", "REGION", "ROBOTS", "VERSION", "STATE"),
    lambda cell: (
        cell.name,
        cell.host or "-",
        cell.region or "-",
        "unknown" if _robots(cell) is None else str(cell.robots),
        cell.version,
        _state(cell),
    ),
    as_dict=lambda cell: vars(cell) | {"robots": _robots(cell)},
)


@cell.command()
@click.argument("name")
@click.option("--wait", is_flag=True, help="Wait until its robots have left.")
@click.option("--timeout", type=float, default=300, show_default=True, metavar="SECONDS")
def drain(name: str, wait: bool, timeout: float) -> None:
    """Take a machine out of service.

    Its robots connect to the others, 20 a second, first those that nobody uses. Drives may last for a minute; no new
    one begins. While no other machine takes robots, they stay, and drives may begin.
    """
    database = open_database()
    with database.transaction() as tx:
        cell_service.drain(tx, SOURCE, name)
    if wait:
        _wait_until_empty(database, name, timeout)
    click.echo(f"cell {name} is {'empty' if wait else 'draining'}")


def _wait_until_empty(database: Database, name: str, timeout: float) -> None:
    wait_for(lambda: not _robots_of(database, name) or None, timeout)
    left = _robots_of(database, name)
    if left is None:
        raise NotDoneError(
            f"cannot see cell {name} empty: it is down, and nobody knows whether robots are still connected there"
        )
    if left:
        raise NotDoneError(
            f"cannot see cell {name} empty after {timeout:g} s: {left} robots are left"
        )


def _robots_of(database: Database, name: str) -> int | None:
    with database.transaction() as tx:
        return _robots(cells.get(tx, name))


@cell.command()
@click.argument("name")
def resume(name: str) -> None:
    """Put a machine back into service. It gets its share of the robots that nobody uses."""
    with open_database().transaction() as tx:
        cell_service.resume(tx, SOURCE, name)
    click.echo(f"cell {name} is in service")


@cell.command()
@click.argument("name")
@YES
def remove(name: str, yes: bool) -> None:
    """Remove a machine that is down and will not come back."""
    remove_after_question(
        "cell",
        name,
        f"Remove cell {name}, and end what it left open?",
        get=cells.get,
        remove=cell_service.remove,
        yes=yes,
    )

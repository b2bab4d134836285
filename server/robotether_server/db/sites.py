"""Sites: where robots are, so that a grant can be for all of them there. Written by services."""

from dataclasses import dataclass

from robotether_server.db.database import Transaction
from robotether_server.field_types import PlainName, RobotName
from robotether_server.problems import RecordExists, RecordMissing


@dataclass(frozen=True)
class Site:
    """A site and its robots' names."""

    id: int
    name: PlainName
    robots: tuple[RobotName, ...]


def add(tx: Transaction, name: str) -> int:
    """Add a site without robots; return its id. Raises RecordExists or RecordRefused."""
    try:
        return tx.insert("INSERT INTO sites (name) VALUES (%s)", (name,))
    except RecordExists as error:
        raise RecordExists(f"cannot add site {name}: the name is taken") from error


def get(tx: Transaction, name: str) -> Site:
    """Return the site of that name; raise RecordMissing."""
    row = tx.row("SELECT id, name FROM sites WHERE name = %s", (name,))
    if row is None:
        raise RecordMissing(f"cannot find site {name}: no such site; add one with: site add {name}")
    robots = tx.rows("SELECT name FROM robots WHERE site_id = %s ORDER BY name", (row["id"],))
    return Site(row["id"], row["name"], tuple(robot["name"] for robot in robots))


def list_all(tx: Transaction) -> list[Site]:
    """Return every site, by name."""
    robots: dict[int, list[str]] = {}
    for row in tx.rows("SELECT site_id, name FROM robots WHERE site_id IS NOT NULL ORDER BY name"):
        robots.setdefault(row["site_id"], []).append(row["name"])
    rows = tx.rows("SELECT id, name FROM sites ORDER BY name")
    return [Site(row["id"], row["name"], tuple(robots.get(row["id"], ()))) for row in rows]


def remove(tx: Transaction, site_id: int) -> None:
    """Remove a site with its grants; its robots stay, at no site."""
    tx.change("DELETE FROM sites WHERE id = %s", (site_id,))


def place(tx: Transaction, robot_id: int, site_id: int | None) -> None:
    """Put a robot at a site, or at none."""
    tx.change("UPDATE robots SET site_id = %s WHERE id = %s", (site_id, robot_id))

"""Grants: what a user, or a group of users, may do with a robot, a site's robots or all. Written by services.

What holds of them, with the admins' own, is in the view relay_grants: the highest level of all that have not ended.
"""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db.database import Transaction, unique
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import Level, PlainName, RobotName, UserName

LEVELS: tuple[Level, ...] = ("observe", "drive", "manage")  # each includes the ones before it

SELECT = (
    "SELECT g.id, u.name AS user, m.name AS `group`, r.name AS robot, s.name AS site, g.level, "
    "g.expires_at AS ends_at FROM grants g "
    "LEFT JOIN users u ON u.id = g.user_id LEFT JOIN user_groups m ON m.id = g.group_id "
    "LEFT JOIN robots r ON r.id = g.robot_id LEFT JOIN sites s ON s.id = g.site_id "
)


@dataclass(frozen=True)
class Grant:
    """What a user or a group may do with a robot or a site, all by name; without both it is for all robots."""

    id: int
    level: Level
    user: str | None = None
    group: str | None = None
    robot: str | None = None
    site: str | None = None
    ends_at: dt.datetime | None = None

    @property
    def is_for_all(self) -> bool:
        """Return whether it is for all robots, future ones included."""
        return self.robot is None and self.site is None

    @property
    def has_ended(self) -> bool:
        """Return whether it has ended."""
        return self.ends_at is not None and self.ends_at <= dt.datetime.now(dt.UTC)

    @property
    def holder_words(self) -> str:
        """Who has it: `user ann` or `group operators`."""
        return f"user {self.user}" if self.user is not None else f"group {self.group}"

    @property
    def scope_words(self) -> str:
        """What it is for: `robot sim1`, `site lab` or `all robots`."""
        if self.is_for_all:
            return "all robots"
        return f"robot {self.robot}" if self.robot is not None else f"site {self.site}"


@dataclass(frozen=True)
class Group:
    """A group and its members' names."""

    id: int
    name: PlainName
    members: tuple[UserName, ...]


@dataclass(frozen=True)
class Site:
    """A site and its robots' names."""

    id: int
    name: PlainName
    robots: tuple[RobotName, ...]


@dataclass(frozen=True)
class Pair:
    """Who and what a grant is for, by their ids: one of the first two, one of the last three."""

    user_id: int | None = None
    group_id: int | None = None
    robot_id: int | None = None
    site_id: int | None = None
    all_robots: bool = False


def includes(held: Level, minimum: Level) -> bool:
    """Return whether one level includes what the other allows."""
    return LEVELS.index(held) >= LEVELS.index(minimum)


def put(tx: Transaction, pair: Pair, level: Level, ends_at: dt.datetime | None = None) -> int:
    """Set the grant of this pair, in place of an earlier one; return its id."""
    return tx.insert(
        "INSERT INTO grants (user_id, group_id, robot_id, site_id, all_robots, level, expires_at) "
        "VALUES (%s, %s, %s, %s, %s, %s, %s) ON DUPLICATE KEY UPDATE "
        "id = LAST_INSERT_ID(id), level = VALUES(level), expires_at = VALUES(expires_at)",
        (
            pair.user_id,
            pair.group_id,
            pair.robot_id,
            pair.site_id,
            pair.all_robots,
            level,
            ends_at,
        ),
    )


def remove(tx: Transaction, grant_id: int) -> None:
    """Remove a grant."""
    tx.change("DELETE FROM grants WHERE id = %s", (grant_id,))


def get(tx: Transaction, grant_id: int) -> Grant:
    """Return one grant; raise RecordMissingError."""
    row = tx.row(SELECT + "WHERE g.id = %s", (grant_id,))
    if row is None:
        raise RecordMissingError(f"cannot find grant {grant_id}: there is none; see: grant list")
    return Grant(**row)


def find(tx: Transaction, pair: Pair) -> Grant | None:
    """Return the grant of this pair, ended or not."""
    row = tx.row(
        SELECT + "WHERE g.user_id <=> %s AND g.group_id <=> %s AND g.robot_id <=> %s "
        "AND g.site_id <=> %s AND g.all_robots = %s",
        (pair.user_id, pair.group_id, pair.robot_id, pair.site_id, pair.all_robots),
    )
    return Grant(**row) if row else None


def list_all(tx: Transaction) -> list[Grant]:
    """Return every grant, ended ones too, users before groups and by name; admins need none."""
    rows = tx.rows(
        SELECT
        + "ORDER BY u.name IS NULL, u.name, m.name, r.name IS NULL, r.name, s.name IS NULL, s.name"
    )
    return [Grant(**row) for row in rows]


def add_group(tx: Transaction, name: str) -> int:
    """Add a group without members; return its id. Raises RecordExistsError or RecordRefusedError."""
    with unique(f"cannot add group {name}: the name is taken"):
        return tx.insert("INSERT INTO user_groups (name) VALUES (%s)", (name,))


def get_group(tx: Transaction, name: str) -> Group:
    """Return the group of that name; raise RecordMissingError."""
    row = tx.row("SELECT id, name FROM user_groups WHERE name = %s", (name,))
    if row is None:
        raise RecordMissingError(
            f"cannot find group {name}: no such group; add one with: group add {name}"
        )
    members = tx.rows(
        "SELECT u.name FROM user_group_members m JOIN users u ON u.id = m.user_id "
        "WHERE m.group_id = %s ORDER BY u.name",
        (row["id"],),
    )
    return Group(row["id"], row["name"], tuple(member["name"] for member in members))


def list_groups(tx: Transaction) -> list[Group]:
    """Return every group, by name."""
    members: dict[int, list[str]] = {}
    for row in tx.rows(
        "SELECT m.group_id, u.name FROM user_group_members m JOIN users u ON u.id = m.user_id "
        "ORDER BY u.name"
    ):
        members.setdefault(row["group_id"], []).append(row["name"])
    rows = tx.rows("SELECT id, name FROM user_groups ORDER BY name")
    return [Group(row["id"], row["name"], tuple(members.get(row["id"], ()))) for row in rows]


def remove_group(tx: Transaction, group_id: int) -> None:
    """Remove a group with its grants; its members stay users."""
    tx.change("DELETE FROM user_groups WHERE id = %s", (group_id,))


def add_member(tx: Transaction, group_id: int, user_id: int) -> bool:
    """Make a user a member; return whether the user was none before."""
    return bool(
        tx.change(
            "INSERT IGNORE INTO user_group_members (group_id, user_id) VALUES (%s, %s)",
            (group_id, user_id),
        )
    )


def remove_member(tx: Transaction, group_id: int, user_id: int) -> bool:
    """End a membership; return whether there was one."""
    return bool(
        tx.change(
            "DELETE FROM user_group_members WHERE group_id = %s AND user_id = %s",
            (group_id, user_id),
        )
    )


def add_site(tx: Transaction, name: str) -> int:
    """Add a site without robots; return its id. Raises RecordExistsError or RecordRefusedError."""
    with unique(f"cannot add site {name}: the name is taken"):
        return tx.insert("INSERT INTO sites (name) VALUES (%s)", (name,))


def get_site(tx: Transaction, name: str) -> Site:
    """Return the site of that name; raise RecordMissingError."""
    row = tx.row("SELECT id, name FROM sites WHERE name = %s", (name,))
    if row is None:
        raise RecordMissingError(
            f"cannot find site {name}: no such site; add one with: site add {name}"
        )
    robots = tx.rows("SELECT name FROM robots WHERE site_id = %s ORDER BY name", (row["id"],))
    return Site(row["id"], row["name"], tuple(robot["name"] for robot in robots))


def list_sites(tx: Transaction) -> list[Site]:
    """Return every site, by name."""
    robots: dict[int, list[str]] = {}
    for row in tx.rows("SELECT site_id, name FROM robots WHERE site_id IS NOT NULL ORDER BY name"):
        robots.setdefault(row["site_id"], []).append(row["name"])
    rows = tx.rows("SELECT id, name FROM sites ORDER BY name")
    return [Site(row["id"], row["name"], tuple(robots.get(row["id"], ()))) for row in rows]


def remove_site(tx: Transaction, site_id: int) -> None:
    """Remove a site with its grants; its robots stay, at no site."""
    tx.change("DELETE FROM sites WHERE id = %s", (site_id,))


def place_robot(tx: Transaction, robot_id: int, site_id: int | None) -> None:
    """Put a robot at a site, or at none."""
    tx.change("UPDATE robots SET site_id = %s WHERE id = %s", (site_id, robot_id))

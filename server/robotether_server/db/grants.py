"""Grants: what a user, or a group of users, may do with a robot, a site's robots or all. Written by services.

What holds of them, with the admins' own, is in the view relay_grants: the highest level of all that have not ended.
Groups of users and sites of robots are here, too, as two collections.
"""

import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Generic, Literal, TypeVar

from robotether_server.db.database import Transaction, Values, unique
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import Level, PlainName, RobotName, UserName

LEVELS: tuple[Level, ...] = ("observe", "drive", "manage")  # each includes the ones before it

SELECT = (
    "SELECT g.id, u.name AS user, m.name AS `group`, r.name AS robot, s.name AS site, g.level, "
    "g.expires_at AS ends_at, COALESCE(g.expires_at <= CURRENT_TIMESTAMP(6), 0) AS has_ended FROM grants g "
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
    has_ended: bool = False

    @property
    def all(self) -> bool:
        """Return whether it is for all robots, future ones included."""
        return self.robot is None and self.site is None

    @property
    def holder_words(self) -> str:
        """Who has it: `user ann` or `group operators`."""
        return f"user {self.user}" if self.user is not None else f"group {self.group}"

    @property
    def scope_words(self) -> str:
        """What it is for: `robot sim1`, `site lab` or `all robots`."""
        if self.all:
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

    @property
    def members(self) -> tuple[RobotName, ...]:
        """Return the robots, by the name that they have in any collection."""
        return self.robots


R = TypeVar("R", Group, Site)


@dataclass(frozen=True, kw_only=True)
class Collection(Generic[R]):
    """The groups or the sites: each has a name and members, and may be in a grant.

    `members` is the name of the record's field; `select` gives a row for each member, with `id`, `name` and `member`.
    """

    kind: Literal["group", "site"]
    members: Literal["members", "robots"]
    record: Callable[[int, PlainName, tuple[str, ...]], R]
    select: str
    insert: str
    delete: str

    def list_all(self, tx: Transaction) -> list[R]:
        """Return every record, by name."""
        return self._find(tx, "ORDER BY c.name, member")

    def names(self, tx: Transaction) -> list[str]:
        """Return every name, in order."""
        return [record.name for record in self.list_all(tx)]

    def get(self, tx: Transaction, name: str) -> R:
        """Return the record of that name; raise RecordMissingError."""
        for record in self._find(tx, "WHERE c.name = %s ORDER BY member", (name,)):
            return record
        raise RecordMissingError(
            f"cannot find {self.kind} {name}: no such {self.kind}; see the list of {self.kind}s"
        )

    def add(self, tx: Transaction, name: str) -> int:
        """Add a record without members; return its id. Raises RecordExistsError or RecordRefusedError."""
        with unique(f"cannot add {self.kind} {name}: the name is taken"):
            return tx.insert(self.insert, (name,))

    def remove(self, tx: Transaction, record_id: int) -> None:
        """Remove a record with its grants; its members stay, without it."""
        tx.change(self.delete, (record_id,))

    def _find(self, tx: Transaction, rest: str, values: Values = ()) -> list[R]:
        rows = tx.rows(self.select + rest, values)
        return [
            self.record(
                record_id,
                name,
                tuple(row["member"] for row in members if row["member"] is not None),
            )
            for (record_id, name), members in groupby(rows, itemgetter("id", "name"))
        ]


GROUPS = Collection(
    kind="group",
    members="members",
    record=Group,
    select="SELECT c.id, c.name, u.name AS member FROM user_groups c "
    "LEFT JOIN user_group_members m ON m.group_id = c.id LEFT JOIN users u ON u.id = m.user_id ",
    insert="INSERT INTO user_groups (name) VALUES (%s)",
    delete="DELETE FROM user_groups WHERE id = %s",
)
SITES = Collection(
    kind="site",
    members="robots",
    record=Site,
    select="SELECT c.id, c.name, r.name AS member FROM sites c LEFT JOIN robots r ON r.site_id = c.id ",
    insert="INSERT INTO sites (name) VALUES (%s)",
    delete="DELETE FROM sites WHERE id = %s",
)


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
    return tx.add(
        "grants",
        {**vars(pair), "level": level, "expires_at": ends_at},
        "ON DUPLICATE KEY UPDATE id = LAST_INSERT_ID(id), level = VALUES(level), expires_at = VALUES(expires_at)",
    )


def remove(tx: Transaction, grant_id: int) -> None:
    """Remove a grant."""
    tx.change("DELETE FROM grants WHERE id = %s", (grant_id,))


def get(tx: Transaction, grant_id: int) -> Grant:
    """Return one grant; raise RecordMissingError."""
    row = tx.row(SELECT + "WHERE g.id = %s", (grant_id,))
    if row is None:
        raise RecordMissingError(
            f"cannot find grant {grant_id}: no such grant; see the list of grants"
        )
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


def place_robot(tx: Transaction, robot_id: int, site_id: int | None) -> None:
    """Put a robot at a site, or at none."""
    tx.change("UPDATE robots SET site_id = %s WHERE id = %s", (site_id, robot_id))

"""Grants: what a user, or a group of users, may do with a robot, a site's robots or all. Written by services.

What holds of them, with the admins' own, is in the view relay_grants: the highest level of all that have not ended.
"""

import datetime as dt
from dataclasses import dataclass
from typing import Literal

from robotether_server.db.database import Row, Transaction
from robotether_server.problems import RecordMissing

Level = Literal["observe", "drive", "manage"]
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
        """Tell whether it is for all robots, future ones included."""
        return self.robot is None and self.site is None

    @property
    def has_ended(self) -> bool:
        """Tell whether it has ended."""
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
class Pair:
    """Who and what a grant is for, by their ids: one of the first two, one of the last three."""

    user_id: int | None = None
    group_id: int | None = None
    robot_id: int | None = None
    site_id: int | None = None
    all_robots: bool = False


def includes(held: Level, asked: Level) -> bool:
    """Tell whether one level includes what the other allows."""
    return LEVELS.index(held) >= LEVELS.index(asked)


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
    """Return one grant; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE g.id = %s", (grant_id,))
    if row is None:
        raise RecordMissing(f"cannot find grant {grant_id}: there is none; see: grant list")
    return _grant(row)


def find(tx: Transaction, pair: Pair) -> Grant | None:
    """Return the grant of this pair, ended or not."""
    row = tx.row(
        SELECT + "WHERE g.user_id <=> %s AND g.group_id <=> %s AND g.robot_id <=> %s "
        "AND g.site_id <=> %s AND g.all_robots = %s",
        (pair.user_id, pair.group_id, pair.robot_id, pair.site_id, pair.all_robots),
    )
    return _grant(row) if row else None


def list_all(tx: Transaction) -> list[Grant]:
    """Return every grant, ended ones too, users before groups and by name; admins need none."""
    rows = tx.rows(
        SELECT
        + "ORDER BY u.name IS NULL, u.name, m.name, r.name IS NULL, r.name, s.name IS NULL, s.name"
    )
    return [_grant(row) for row in rows]


def _grant(row: Row) -> Grant:
    return Grant(**row)

"""Grants: what a user may do with a robot. Written by administration.

The relay reads them, with the admins' own, through the view relay_grants.
"""

from dataclasses import dataclass
from typing import Literal

from robotether_server.store.database import Transaction

Level = Literal["observe", "drive", "manage"]
LEVELS: tuple[Level, ...] = ("observe", "drive", "manage")  # each includes the ones before it


@dataclass(frozen=True)
class Grant:
    """What a user may do with a robot, both by name."""

    user: str
    robot: str
    level: Level


def includes(held: Level, asked: Level) -> bool:
    """Tell whether who holds one level may do what asks for the other."""
    return LEVELS.index(held) >= LEVELS.index(asked)


def give(tx: Transaction, user_id: int, robot_id: int, level: Level) -> None:
    """Set what the user may do with the robot, in place of an earlier grant."""
    tx.change(
        "INSERT INTO grants (user_id, robot_id, level) VALUES (%s, %s, %s) "
        "ON DUPLICATE KEY UPDATE level = VALUES(level)",
        (user_id, robot_id, level),
    )


def take(tx: Transaction, user_id: int, robot_id: int) -> bool:
    """Remove the grant; return whether there was one."""
    return bool(
        tx.change("DELETE FROM grants WHERE user_id = %s AND robot_id = %s", (user_id, robot_id))
    )


def list_all(tx: Transaction) -> list[Grant]:
    """Return every grant, by user and robot; admins need none."""
    rows = tx.rows(
        "SELECT u.name AS user, r.name AS robot, g.level FROM grants g "
        "JOIN users u ON u.id = g.user_id JOIN robots r ON r.id = g.robot_id "
        "ORDER BY u.name, r.name"
    )
    return [Grant(**row) for row in rows]

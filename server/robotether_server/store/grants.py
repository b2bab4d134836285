"""Grants: what a user may do with a robot. Written by the cli.

The relay reads them, with the admins' own, through the view relay_grants.
"""

from typing import Literal

from robotether_server.store.database import Transaction

Level = Literal["observe", "drive", "manage"]
LEVELS: tuple[Level, ...] = ("observe", "drive", "manage")  # each includes the ones before it


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

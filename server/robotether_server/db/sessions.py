"""Robots' sessions as web shows them. Only the relay writes them (db/fleet.py)."""

from dataclasses import dataclass

from robotether_server.db.database import Transaction
from robotether_server.field_types import Timestamp


@dataclass(frozen=True)
class RecordedSession:
    """One session; `ended_at` is None while it lasts."""

    started_at: Timestamp
    ended_at: Timestamp | None
    end_code: str | None
    address: str
    agent_version: str | None


def of_robot(tx: Transaction, robot_id: int, limit: int) -> list[RecordedSession]:
    """Return a robot's sessions, the newest first, `limit` at most."""
    rows = tx.rows(
        "SELECT started_at, ended_at, end_code, address, agent_version FROM robot_sessions "
        "WHERE robot_id = %s ORDER BY id DESC LIMIT %s",
        (robot_id, limit),
    )
    return [RecordedSession(**row) for row in rows]


def is_online(tx: Transaction, robot_id: int) -> bool:
    """Tell whether the robot has a session now."""
    newest = of_robot(tx, robot_id, 1)
    return bool(newest) and newest[0].ended_at is None

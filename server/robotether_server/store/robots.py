"""Robots: their records, and the fleet as one user may see it.

Written by web (join) and cli. The database itself normalises MACs and allots ports.
"""

import datetime as dt
import json
from dataclasses import dataclass, field
from typing import Any, Literal

from robotether_server.problems import RecordExists, RecordMissing
from robotether_server.ssh_keys import PublicKey
from robotether_server.store.database import Row, Transaction
from robotether_server.store.grants import Level
from robotether_server.store.users import User

State = Literal["pending", "active", "disabled"]

SELECT = (
    "SELECT r.id, r.mac, r.name, r.state, r.ros_port, r.video_port, r.fingerprint, r.settings "
    "FROM robots r "
)
# The newest session tells presence: one that has not ended is a robot that is online.
SELECT_SEEN = (
    "SELECT r.id, r.mac, r.name, r.state, r.ros_port, r.video_port, r.fingerprint, r.settings, "
    "s.id IS NOT NULL AND s.ended_at IS NULL AS online, "
    "COALESCE(s.ended_at, s.started_at) AS since, "
    "IF(%(admin)s, 'manage', g.level) AS level "
    "FROM robots r "
    "LEFT JOIN robot_sessions s "
    "ON s.id = (SELECT MAX(newest.id) FROM robot_sessions newest WHERE newest.robot_id = r.id) "
    "LEFT JOIN grants g ON g.robot_id = r.id AND g.user_id = %(user_id)s "
    "WHERE (%(admin)s OR g.level IS NOT NULL) "
)


@dataclass(frozen=True)
class Robot:
    """One robot's record. No fingerprint: it has not shown a key yet."""

    id: int
    mac: str
    name: str
    state: State
    ros_port: int
    video_port: int
    fingerprint: str | None
    settings: dict[str, Any] = field(hash=False)


@dataclass(frozen=True)
class SeenRobot:
    """A robot as one user sees it. `since`: the last change of `online`; None: never seen."""

    robot: Robot
    online: bool
    since: dt.datetime | None
    level: Level


@dataclass(frozen=True)
class Report:
    """What a robot tells about itself when it joins."""

    hostname: str
    agent_version: str
    address: str


def _robot(row: Row) -> Robot:
    return Robot(
        id=row["id"],
        mac=row["mac"],
        name=row["name"],
        state=row["state"],
        ros_port=row["ros_port"],
        video_port=row["video_port"],
        fingerprint=row["fingerprint"],
        settings=json.loads(row["settings"]),
    )


def _seen(row: Row) -> SeenRobot:
    return SeenRobot(_robot(row), bool(row["online"]), row["since"], row["level"])


def list_seen(tx: Transaction, user: User) -> list[SeenRobot]:
    """Return the robots that the user may see, by name; admins see all, as managers."""
    values = {"admin": user.is_admin, "user_id": user.id}
    return [_seen(row) for row in tx.rows(SELECT_SEEN + "ORDER BY r.name", values)]


def find_seen(tx: Transaction, user: User, name: str) -> SeenRobot | None:
    """Return one robot, if there is one of that name that the user may see."""
    values = {"admin": user.is_admin, "user_id": user.id, "name": name}
    row = tx.row(SELECT_SEEN + "AND r.name = %(name)s", values)
    return _seen(row) if row else None


def list_all(tx: Transaction) -> list[SeenRobot]:
    """Return every robot, by name, as an admin sees it."""
    values = {"admin": True, "user_id": 0}
    return [_seen(row) for row in tx.rows(SELECT_SEEN + "ORDER BY r.name", values)]


def get(tx: Transaction, name: str) -> Robot:
    """Return the robot of that name, locked until the transaction ends; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE r.name = %s FOR UPDATE", (name,))
    if row is None:
        raise RecordMissing(f"cannot find robot {name}: no such robot; see: robot list")
    return _robot(row)


def find_by_mac(tx: Transaction, mac: str) -> Robot | None:
    """Return the robot of that MAC, locked until the transaction ends."""
    row = tx.row(SELECT + "WHERE r.mac = %s FOR UPDATE", (mac,))
    return _robot(row) if row else None


def name_is_taken(tx: Transaction, name: str) -> bool:
    """Tell whether a robot has that name."""
    return tx.row("SELECT 1 FROM robots WHERE name = %s", (name,)) is not None


def count_pending(tx: Transaction) -> int:
    """Return how many robots have shown a key and wait for approval."""
    row = tx.row(
        "SELECT COUNT(*) AS waiting FROM robots WHERE state = 'pending' AND fingerprint IS NOT NULL"
    )
    return int(row["waiting"]) if row else 0


def add(tx: Transaction, mac: str, name: str) -> int:
    """Add a robot; the database allots its ports. Raises RecordExists or RecordRefused."""
    try:
        return tx.insert("INSERT INTO robots (mac, name) VALUES (%s, %s)", (mac, name))
    except RecordExists as error:
        taken = f"MAC {mac}" if error.key == "mac" else f"name {name}"
        raise RecordExists(
            f"cannot add robot {name}: another robot has the {taken}", error.key
        ) from error


def set_state(tx: Transaction, robot_id: int, state: State) -> None:
    """Approve, disable or enable a robot."""
    tx.change("UPDATE robots SET state = %s WHERE id = %s", (state, robot_id))


def set_key(tx: Transaction, robot_id: int, key: PublicKey) -> None:
    """Write down the key that proves to be this robot. Raises RecordExists."""
    tx.change(
        "UPDATE robots SET public_key = %s, fingerprint = %s WHERE id = %s",
        (key.line, key.fingerprint, robot_id),
    )


def set_report(tx: Transaction, robot_id: int, report: Report) -> None:
    """Write down what the robot told when it joined."""
    tx.change(
        "UPDATE robots SET hostname = %s, agent_version = %s, join_address = %s WHERE id = %s",
        (report.hostname, report.agent_version, report.address, robot_id),
    )

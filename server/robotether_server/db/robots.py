"""Robots: their records, and the fleet as one user may see it.

Written by services. The database itself normalises MACs and allots ports.
"""

import datetime as dt
import json
from dataclasses import dataclass, field
from typing import Any, Literal

from robotether_server.db.database import Row, Transaction
from robotether_server.db.grants import Level
from robotether_server.db.users import User
from robotether_server.problems import RecordExists, RecordMissing
from robotether_server.ssh_keys import PublicKey

State = Literal["pending", "active", "disabled"]

COLUMNS = (
    "r.id, r.mac, r.name, r.state, r.ros_port, r.video_port, r.fingerprint, r.settings, "
    "r.hostname, r.agent_version, r.join_address, r.joined_at, r.public_key, r.stranger, r.had_key, "
    "r.shell, r.shell_port, r.rotate_requested_at, "
    "(SELECT name FROM sites WHERE id = r.site_id) AS site"
)
SELECT = f"SELECT {COLUMNS} FROM robots r "  # noqa: S608 - the module's own text
# The newest session tells presence: one that has not ended is a robot that is online.
SELECT_SEEN = (
    f"SELECT {COLUMNS}, "  # noqa: S608 - the module's own text
    "s.id IS NOT NULL AND s.ended_at IS NULL AS online, "
    "COALESCE(s.ended_at, s.started_at) AS since, "
    "COALESCE(s.address, r.join_address) AS seen_address, "
    "COALESCE(s.agent_version, r.agent_version) AS seen_version, "
    "s.ended_at IS NULL AND COALESCE(s.ros_exposed, FALSE) AS ros_exposed, "
    "IF(%(admin)s, 'manage', g.level) AS level "
    "FROM robots r "
    "LEFT JOIN robot_sessions s "
    "ON s.id = (SELECT MAX(newest.id) FROM robot_sessions newest WHERE newest.robot_id = r.id) "
    "LEFT JOIN (SELECT robot_id, level FROM relay_grants WHERE user_id = %(user_id)s) g "
    "ON g.robot_id = r.id "
    "WHERE (%(admin)s OR g.level IS NOT NULL) "
)


@dataclass(frozen=True)
class Report:
    """What a robot told about itself when it joined; `address` is where the join came from."""

    hostname: str
    agent_version: str
    address: str


@dataclass(frozen=True)
class Robot:
    """One robot's record.

    No fingerprint: it has not shown a key yet; `report` and `joined_at` tell of the join that did.
    `is_unknown`: no admin announced it or has dealt with it. `had_key`: this or another key stood here once.
    """

    id: int
    mac: str
    name: str
    state: State
    ros_port: int
    video_port: int
    fingerprint: str | None
    settings: dict[str, Any] = field(hash=False)
    report: Report | None = None
    joined_at: dt.datetime | None = None
    public_key: str | None = None
    is_unknown: bool = False
    had_key: bool = False
    shell: bool = False
    shell_port: int | None = None
    rotate_requested_at: dt.datetime | None = None
    site: str | None = None

    @property
    def key(self) -> PublicKey | None:
        """The key that stands in the row, be it approved or not."""
        if self.public_key is None or self.fingerprint is None:
            return None
        return PublicKey(self.public_key, self.fingerprint)


@dataclass(frozen=True)
class SeenRobot:
    """A robot as one user sees it.

    `since`: the last change of `online`; None: never seen. `address` and `agent_version` are the newest
    session's, or else the join's. `ros_exposed`: everybody in the robot's own network reaches its rosbridge.
    """

    robot: Robot
    online: bool
    since: dt.datetime | None
    level: Level
    address: str | None = None
    agent_version: str | None = None
    ros_exposed: bool = False


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
        report=_report(row),
        joined_at=row["joined_at"],
        public_key=row["public_key"],
        is_unknown=bool(row["stranger"]),
        had_key=bool(row["had_key"]),
        shell=bool(row["shell"]),
        shell_port=row["shell_port"],
        rotate_requested_at=row["rotate_requested_at"],
        site=row["site"],
    )


def _report(row: Row) -> Report | None:
    if row["hostname"] is None:
        return None
    return Report(row["hostname"], row["agent_version"], row["join_address"])


def _seen(row: Row) -> SeenRobot:
    return SeenRobot(
        robot=_robot(row),
        online=bool(row["online"]),
        since=row["since"],
        level=row["level"],
        address=row["seen_address"],
        agent_version=row["seen_version"],
        ros_exposed=bool(row["ros_exposed"]),
    )


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


def count_seen(tx: Transaction) -> dict[int, int]:
    """Return how many robots each user may see, by the user's id; nothing for who sees none."""
    rows = tx.rows("SELECT user_id, COUNT(*) AS robots FROM relay_grants GROUP BY user_id")
    return {row["user_id"]: row["robots"] for row in rows}


def get_seen(tx: Transaction, name: str) -> SeenRobot:
    """Return one robot as an admin sees it; raise RecordMissing."""
    values = {"admin": True, "user_id": 0, "name": name}
    row = tx.row(SELECT_SEEN + "AND r.name = %(name)s", values)
    if row is None:
        raise _missing(name)
    return _seen(row)


def get(tx: Transaction, name: str) -> Robot:
    """Return the robot of that name, locked until the transaction ends; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE r.name = %s FOR UPDATE", (name,))
    if row is None:
        raise _missing(name)
    return _robot(row)


def _missing(name: str) -> RecordMissing:
    return RecordMissing(f"cannot find robot {name}: no such robot; see: robot list")


def find_by_mac(tx: Transaction, mac: str) -> Robot | None:
    """Return the robot of that MAC, locked until the transaction ends."""
    row = tx.row(SELECT + "WHERE r.mac = %s FOR UPDATE", (mac,))
    return _robot(row) if row else None


def find_by_key(tx: Transaction, fingerprint: str) -> Robot | None:
    """Return the robot whose row holds that key, locked until the transaction ends."""
    row = tx.row(SELECT + "WHERE r.fingerprint = %s FOR UPDATE", (fingerprint,))
    return _robot(row) if row else None


def peek_by_mac(tx: Transaction, mac: str) -> Robot | None:
    """Return the robot of that MAC without locking it."""
    row = tx.row(SELECT + "WHERE r.mac = %s", (mac,))
    return _robot(row) if row else None


def list_waiting(tx: Transaction) -> list[Robot]:
    """Return the robots whose key waits for approval, the oldest first."""
    rows = tx.rows(
        SELECT
        + "WHERE r.state = 'pending' AND r.fingerprint IS NOT NULL ORDER BY r.joined_at, r.id"
    )
    return [_robot(row) for row in rows]


def name_is_taken(tx: Transaction, name: str) -> bool:
    """Tell whether a robot has that name."""
    return tx.row("SELECT 1 FROM robots WHERE name = %s", (name,)) is not None


def unknown_addresses(tx: Transaction) -> list[str]:
    """Return where the joins of unknown robots came from: robots that nobody announced or approved."""
    rows = tx.rows("SELECT join_address FROM robots WHERE state = 'pending' AND stranger")
    return [row["join_address"] or "" for row in rows]


def remove_unknown(tx: Transaction, before: dt.datetime) -> None:
    """Remove the unknown robots that joined before that moment, but for those that somebody has a grant for."""
    # Asked first without locks: mostly there is none, and a join must not wait for all other joins.
    expired = tx.rows(
        "SELECT id FROM robots WHERE state = 'pending' AND stranger AND joined_at < %s "
        "AND NOT EXISTS (SELECT 1 FROM grants g WHERE g.robot_id = robots.id) ORDER BY id",
        (before,),
    )
    for row in expired:
        # Perhaps an admin has just approved it.
        tx.change(
            "DELETE FROM robots WHERE id = %s AND state = 'pending' AND stranger", (row["id"],)
        )


def add(tx: Transaction, mac: str, name: str, *, unknown: bool = False) -> int:
    """Add a robot; the database allots its ports. Raises RecordExists or RecordRefused."""
    try:
        return tx.insert(
            "INSERT INTO robots (mac, name, stranger) VALUES (%s, %s, %s)", (mac, name, unknown)
        )
    except RecordExists as error:
        taken = f"MAC {mac}" if error.key == "mac" else f"name {name}"
        raise RecordExists(
            f"cannot add robot {name}: another robot has the {taken}", error.key
        ) from error


def set_state(tx: Transaction, robot_id: int, state: State) -> None:
    """Approve, disable or enable a robot. Whoever an admin has dealt with is not unknown any more."""
    tx.change(
        "UPDATE robots SET state = %(state)s, stranger = stranger AND %(state)s = 'pending' "
        "WHERE id = %(id)s",
        {"state": state, "id": robot_id},
    )


def set_key(tx: Transaction, robot_id: int, key: PublicKey, report: Report) -> None:
    """Write down the key that a robot showed, and what it told with it. Raises RecordExists.

    What logged in with an earlier key ends; `rotate_key` is for a key whose connections live on.
    """
    tx.change(
        "UPDATE robots SET public_key = %s, fingerprint = %s, joined_at = CURRENT_TIMESTAMP(6), "
        "previous_fingerprint = NULL, rotate_requested_at = NULL, "
        "hostname = %s, agent_version = %s, join_address = %s WHERE id = %s",
        (
            key.line,
            key.fingerprint,
            report.hostname,
            report.agent_version,
            report.address,
            robot_id,
        ),
    )


def rotate_key(tx: Transaction, robot_id: int, key: PublicKey) -> None:
    """Put a new key in place of the robot's own, whose connections live on. Raises RecordExists."""
    tx.change(
        # Set from left to right: the first takes the old key's fingerprint.
        "UPDATE robots SET previous_fingerprint = fingerprint, fingerprint = %s, public_key = %s, "
        "rotate_requested_at = NULL WHERE id = %s",
        (key.fingerprint, key.line, robot_id),
    )


def request_rotation(tx: Transaction, robot_id: int) -> None:
    """Note that the robot is to make a new key; the relay passes it on."""
    tx.change(
        "UPDATE robots SET rotate_requested_at = CURRENT_TIMESTAMP(6) WHERE id = %s", (robot_id,)
    )


def forget_key(tx: Transaction, robot_id: int) -> None:
    """Forget the key and the join that brought it, so that the next join brings another."""
    tx.change(
        "UPDATE robots SET public_key = NULL, fingerprint = NULL, joined_at = NULL, "
        "previous_fingerprint = NULL, rotate_requested_at = NULL, "
        "hostname = NULL, agent_version = NULL, join_address = NULL, stranger = FALSE WHERE id = %s",
        (robot_id,),
    )


def rename(tx: Transaction, robot_id: int, name: str) -> None:
    """Give the robot another name. Raises RecordExists or RecordRefused."""
    try:
        tx.change("UPDATE robots SET name = %s WHERE id = %s", (name, robot_id))
    except RecordExists as error:
        raise RecordExists(
            f"cannot use the name {name}: another robot has it", error.key
        ) from error


def announce(tx: Transaction, robot_id: int) -> None:
    """Note that an admin expects this robot, so that it does not expire."""
    tx.change("UPDATE robots SET stranger = FALSE WHERE id = %s", (robot_id,))


def set_mac(tx: Transaction, robot_id: int, mac: str) -> None:
    """Give the robot another MAC. Raises RecordExists or RecordRefused."""
    try:
        tx.change("UPDATE robots SET mac = %s WHERE id = %s", (mac, robot_id))
    except RecordExists as error:
        raise RecordExists(f"cannot use the MAC {mac}: another robot has it", error.key) from error


def set_ports(tx: Transaction, robot_id: int, ros: int | None, video: int | None) -> None:
    """Move the robot to these ports; to another free pair with None for both. Raises RecordRefused."""
    try:
        tx.change(
            "UPDATE robots SET ros_port = %s, video_port = %s WHERE id = %s", (ros, video, robot_id)
        )
    except RecordExists as error:
        raise RecordExists(
            f"cannot use the ports {ros} and {video}: another robot has one of them", error.key
        ) from error


def set_shell(tx: Transaction, robot_id: int, *, on: bool) -> None:
    """Allot the robot a port for a shell, or free it. Raises RecordRefused."""
    tx.change("UPDATE robots SET shell = %s WHERE id = %s", (on, robot_id))


def set_settings(tx: Transaction, robot_id: int, settings: dict[str, Any]) -> None:
    """Replace the robot's settings."""
    tx.change("UPDATE robots SET settings = %s WHERE id = %s", (json.dumps(settings), robot_id))


def remove(tx: Transaction, robot_id: int) -> None:
    """Remove a robot with its grants and its sessions; its ports are free again."""
    tx.change("DELETE FROM robots WHERE id = %s", (robot_id,))

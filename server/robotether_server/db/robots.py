"""Robots: their records and their keys. Written by services.

The database itself normalises MACs and allots ports.

A key that no robot has is a claim, which waits because the MAC's robot has another key and goes with that robot's row;
or it was rejected, and outlives the row.
"""

import datetime as dt
import json
from dataclasses import dataclass, field
from typing import Any, Literal

from robotether_server.db.database import Row, Transaction, unique
from robotether_server.identity import PublicKey
from robotether_server.problems import RecordExistsError, RecordMissingError, StoreUnavailableError
from robotether_server.schemas import Fingerprint, RobotName, Timestamp

State = Literal["pending", "active", "disabled"]
Reason = Literal["approval_pending", "mac_in_use"]

# Time limit for the lock, which is held for milliseconds; a waiting request holds one of web's few
# threads.
LOCK_WAIT_S = 3
# Maximum number of refused joins that are kept of one network, and of all; strangers may ask for any MAC.
MAX_REFUSED_OF_NETWORK, MAX_REFUSED = 10, 100
REFUSED_FOR = dt.timedelta(days=1)

COLUMNS = (
    "r.id, r.mac, r.name, r.state, r.ros_port, r.video_port, r.fingerprint, r.settings, "
    "r.hostname, r.agent_version, r.join_address, r.joined_at, r.public_key, r.stranger AS is_unknown, r.had_key, "
    "r.shell, r.shell_port, r.rotate_requested_at, "
    "(SELECT name FROM sites WHERE id = r.site_id) AS site"
)
SELECT = f"SELECT {COLUMNS} FROM robots r "  # noqa: S608 - the module's own text
SELECT_CLAIM = "SELECT id, fingerprint, public_key, robot_id, mac, hostname, agent_version, address FROM key_claims "
# A key that somebody wrote by SQL came with no join.
SELECT_WAITING = (
    "SELECT name AS robot, mac, IFNULL(hostname, '') AS hostname, IFNULL(join_address, '') AS address, fingerprint, "
    "IFNULL(agent_version, '') AS agent_version, IFNULL(joined_at, FROM_UNIXTIME(0)) AS joined_at, "
    "'approval_pending' AS reason FROM robots WHERE state = 'pending' AND fingerprint IS NOT NULL "
    "UNION ALL SELECT r.name, c.mac, c.hostname, c.address, c.fingerprint, c.agent_version, c.claimed_at, "
    "'mac_in_use' FROM key_claims c JOIN robots r ON r.id = c.robot_id ORDER BY joined_at, reason"
)
SELECT_REJECTED = (
    "SELECT id, fingerprint, robot, mac, IFNULL(hostname, '') AS hostname, IFNULL(address, '') AS address, "
    "rejected_at, rejected_by FROM key_claims WHERE rejected_at IS NOT NULL "
)


@dataclass(frozen=True)
class Report:
    """What a robot said about itself when it joined; `address` is where the join came from."""

    hostname: str
    agent_version: str
    address: str


@dataclass(frozen=True)
class RobotRow:
    """One robot's record.

    No fingerprint: it has not shown a key yet; `report` and `joined_at` are of the join that did.
    `is_unknown`: no admin announced it or has dealt with it. `had_key`: this or another key was here once.
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
    def region(self) -> str | None:
        """Where the robot is, whose cells it connects to first."""
        region = self.settings.get("region")
        # Somebody may have written another thing by SQL.
        return region if isinstance(region, str) else None

    @property
    def key(self) -> PublicKey | None:
        """The key in the row, approved or not."""
        if self.public_key is None or self.fingerprint is None:
            return None
        return PublicKey(self.public_key, self.fingerprint)


@dataclass(frozen=True)
class RefusedJoin:
    """The newest refusal of a MAC from one network, and how often it was refused there within a day."""

    mac: str
    fingerprint: str
    report: Report
    code: str
    detail: str
    times: int
    refused_at: dt.datetime


@dataclass(frozen=True)
class Claim:
    """A key that waits beside the one of a robot, or was rejected."""

    id: int
    key: PublicKey
    robot_id: int | None
    mac: str
    report: Report

    @property
    def is_rejected(self) -> bool:
        """Whether an admin turned the key away."""
        return self.robot_id is None


@dataclass(frozen=True)
class PendingKey:
    """A key that waits; with `mac_in_use` the robot goes on with another key meanwhile."""

    robot: RobotName
    mac: str
    hostname: str
    address: str
    fingerprint: Fingerprint
    agent_version: str
    joined_at: Timestamp
    reason: Reason


@dataclass(frozen=True)
class RejectedKey:
    """A rejected key; `robot` is the name that its robot had then."""

    id: int
    fingerprint: Fingerprint
    robot: str
    mac: str
    hostname: str
    address: str
    rejected_at: Timestamp
    rejected_by: str


def lock_enrolment(tx: Transaction) -> None:
    """Make joins, and what admins do to robots' rows and keys, take turns; raise StoreUnavailableError.

    Held until after the transaction's commit. A join decides by several rows at once: whose the
    MAC is, whether another row or a claim has the key, how many wait, which name is free. Row locks in changing order
    would end some of those who join at the same time with a deadlock; with this lock each finds what the one before
    it left. A transaction that needs it takes it first, before any row.
    """
    if not tx.lock("robotether.enrolment", LOCK_WAIT_S):
        raise StoreUnavailableError(
            f"cannot change robots: other changes have been running for {LOCK_WAIT_S} s; try again shortly"
        )


def from_row(row: Row) -> RobotRow:
    """Make a robot of a row of SELECT, which may have more columns."""
    columns = {name: row[name] for name in RobotRow.__dataclass_fields__ if name in row}
    columns |= {name: bool(row[name]) for name in ("is_unknown", "had_key", "shell")}
    if row["hostname"] is not None:
        columns["report"] = Report(row["hostname"], row["agent_version"], row["join_address"])
    return RobotRow(**columns | {"settings": json.loads(row["settings"])})


def get(tx: Transaction, name: str) -> RobotRow:
    """Return the robot of that name, locked until the transaction ends; raise RecordMissingError."""
    row = tx.row(SELECT + "WHERE r.name = %s FOR UPDATE", (name,))
    if row is None:
        raise missing(name)
    return from_row(row)


def missing(name: str) -> RecordMissingError:
    """Return the problem of a name that no robot has."""
    return RecordMissingError(f"cannot find robot {name}: no such robot; see the list of robots")


def find_by_mac(tx: Transaction, mac: str) -> RobotRow | None:
    """Return the robot of that MAC, locked until the transaction ends."""
    row = tx.row(SELECT + "WHERE r.mac = %s FOR UPDATE", (mac,))
    return from_row(row) if row else None


def find_by_key(tx: Transaction, fingerprint: str) -> RobotRow | None:
    """Return the robot whose row holds that key, locked until the transaction ends."""
    row = tx.row(SELECT + "WHERE r.fingerprint = %s FOR UPDATE", (fingerprint,))
    return from_row(row) if row else None


def peek_by_mac(tx: Transaction, mac: str) -> RobotRow | None:
    """Return the robot of that MAC without locking it."""
    row = tx.row(SELECT + "WHERE r.mac = %s", (mac,))
    return from_row(row) if row else None


def list_waiting(tx: Transaction) -> list[PendingKey]:
    """Return every key that waits for an admin, the oldest first."""
    return [PendingKey(**row) for row in tx.rows(SELECT_WAITING)]


def list_active_names(tx: Transaction) -> list[str]:
    """Return the names of the robots that may connect, in order."""
    return [
        row["name"]
        for row in tx.rows("SELECT name FROM robots WHERE state = 'active' ORDER BY name")
    ]


def name_is_taken(tx: Transaction, name: str) -> bool:
    """Return whether a robot has that name."""
    return tx.row("SELECT 1 FROM robots WHERE name = %s", (name,)) is not None


def waiting_addresses(tx: Transaction) -> list[str]:
    """Return where the joins came from of claims, and of robots that nobody announced or approved."""
    rows = tx.rows(
        "SELECT join_address AS address FROM robots WHERE state = 'pending' AND stranger "
        "UNION ALL SELECT address FROM key_claims WHERE rejected_at IS NULL"
    )
    return [row["address"] or "" for row in rows]


def remove_unknown(tx: Transaction, before: dt.datetime) -> None:
    """Remove the unknown robots that joined before that time, except those with a grant."""
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
    """Add a robot; the database allots its ports. Raises RecordExistsError or RecordRefusedError."""
    try:
        return tx.insert(
            "INSERT INTO robots (mac, name, stranger) VALUES (%s, %s, %s)", (mac, name, unknown)
        )
    except RecordExistsError as error:
        value = f"MAC {mac}" if error.key == "mac" else f"name {name}"
        raise RecordExistsError(
            f"cannot add robot {name}: another robot has the {value}", error.key
        ) from error


def set_state(tx: Transaction, robot_id: int, state: State) -> None:
    """Approve, disable or enable a robot. Whoever an admin has dealt with is not unknown any more."""
    tx.change(
        "UPDATE robots SET state = %(state)s, stranger = stranger AND %(state)s = 'pending' "
        "WHERE id = %(id)s",
        {"state": state, "id": robot_id},
    )


def set_key(tx: Transaction, robot_id: int, key: PublicKey, report: Report) -> None:
    """Write down the key that a robot showed, and what it said with it. Raises RecordExistsError.

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
    """Put a new key in place of the robot's own, whose connections live on. Raises RecordExistsError."""
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
    """Give the robot another name. Raises RecordExistsError or RecordRefusedError."""
    with unique(f"cannot use the name {name}: another robot has it"):
        tx.change("UPDATE robots SET name = %s WHERE id = %s", (name, robot_id))


def announce(tx: Transaction, robot_id: int) -> None:
    """Note that an admin expects this robot, so that it does not expire."""
    tx.change("UPDATE robots SET stranger = FALSE WHERE id = %s", (robot_id,))


def set_mac(tx: Transaction, robot_id: int, mac: str) -> None:
    """Give the robot another MAC. Raises RecordExistsError or RecordRefusedError."""
    with unique(f"cannot use the MAC {mac}: another robot has it"):
        tx.change("UPDATE robots SET mac = %s WHERE id = %s", (mac, robot_id))


def set_ports(tx: Transaction, robot_id: int, ros: int | None, video: int | None) -> None:
    """Move the robot to these ports; to another free pair with None for both. Raises RecordRefusedError."""
    with unique(f"cannot use the ports {ros} and {video}: another robot has one of them"):
        tx.change(
            "UPDATE robots SET ros_port = %s, video_port = %s WHERE id = %s", (ros, video, robot_id)
        )


def set_shell(tx: Transaction, robot_id: int, *, on: bool) -> None:
    """Allot the robot a port for a shell, or free it. Raises RecordRefusedError."""
    tx.change("UPDATE robots SET shell = %s WHERE id = %s", (on, robot_id))


def set_settings(tx: Transaction, robot_id: int, settings: dict[str, Any]) -> None:
    """Replace the robot's settings."""
    tx.change("UPDATE robots SET settings = %s WHERE id = %s", (json.dumps(settings), robot_id))


def remove(tx: Transaction, robot_id: int) -> None:
    """Remove a robot with its grants and its sessions; its ports are free again."""
    tx.change("DELETE FROM robots WHERE id = %s", (robot_id,))


def _claim(row: Row) -> Claim:
    key = PublicKey(row.pop("public_key"), row.pop("fingerprint"))
    report = Report(*(row.pop(name) or "" for name in ("hostname", "agent_version", "address")))
    return Claim(key=key, report=report, **row)


def find_claim(tx: Transaction, fingerprint: str) -> Claim | None:
    """Return the claim or rejected key of that fingerprint, locked until the transaction ends."""
    row = tx.row(SELECT_CLAIM + "WHERE fingerprint = %s FOR UPDATE", (fingerprint,))
    return _claim(row) if row else None


def add_claim(tx: Transaction, robot: RobotRow, key: PublicKey, report: Report) -> int:
    """Write down that a key wants to be the one of that robot; return its id. Raises RecordExistsError."""
    return tx.add(
        "key_claims",
        {
            "robot_id": robot.id,
            "robot": robot.name,
            "mac": robot.mac,
            "fingerprint": key.fingerprint,
            "public_key": key.line,
            **vars(report),
        },
    )


def reject_claim(tx: Transaction, claim_id: int, robot: str, by: str) -> None:
    """Turn a claim away; its key is remembered."""
    tx.change(
        "UPDATE key_claims SET robot_id = NULL, robot = %s, rejected_at = CURRENT_TIMESTAMP(6), "
        "rejected_by = %s WHERE id = %s",
        (robot, by, claim_id),
    )


def remove_claim(tx: Transaction, claim_id: int) -> None:
    """Forget a claim or a rejected key."""
    tx.change("DELETE FROM key_claims WHERE id = %s", (claim_id,))


def remove_old_claims(tx: Transaction, before: dt.datetime) -> None:
    """Remove the claims that came before that time; rejected keys stay."""
    tx.change("DELETE FROM key_claims WHERE rejected_at IS NULL AND claimed_at < %s", (before,))


def list_rejected_keys(tx: Transaction) -> list[RejectedKey]:
    """Return every rejected key, the newest first."""
    rows = tx.rows(SELECT_REJECTED + "ORDER BY rejected_at DESC, id DESC")
    return [RejectedKey(**row) for row in rows]


def get_rejected_key(tx: Transaction, claim_id: int) -> RejectedKey:
    """Return the rejected key of that id; raise RecordMissingError."""
    row = tx.row(SELECT_REJECTED + "AND id = %s FOR UPDATE", (claim_id,))
    if row is None:
        raise RecordMissingError(
            f"cannot find rejected key {claim_id}: there is none of that number"
        )
    return RejectedKey(**row)


def record_refusal(tx: Transaction, refused: RefusedJoin, network: str) -> None:
    """Keep a refused join in place of what was refused before to this MAC there, and of the oldest of too many."""
    tx.change(
        "DELETE FROM refused_joins WHERE refused_at < %s", (refused.refused_at - REFUSED_FOR,)
    )
    values = {
        "fingerprint": refused.fingerprint,
        **vars(refused.report),
        "code": refused.code,
        "detail": refused.detail[:1000],
        "refused_at": refused.refused_at,
    }
    changes = ", ".join(f"{column} = VALUES({column})" for column in values)
    tx.add(
        "refused_joins",
        {"mac": refused.mac, "network": network, **values},
        f"ON DUPLICATE KEY UPDATE times = times + 1, {changes}",
    )
    for of_network, limit in ((network, MAX_REFUSED_OF_NETWORK), (None, MAX_REFUSED)):
        where = "network = COALESCE(%s, network)"
        oldest = tx.row(
            f"SELECT refused_at FROM refused_joins WHERE {where} ORDER BY refused_at DESC LIMIT 1 OFFSET %s",  # noqa: S608 - our own text
            (of_network, limit),
        )
        if oldest is not None:
            tx.change(
                f"DELETE FROM refused_joins WHERE {where} AND refused_at <= %s",  # noqa: S608 - as above
                (of_network, oldest["refused_at"]),
            )


def remove_refusals(tx: Transaction, mac: str, fingerprint: str) -> None:
    """Forget the refusals of a key that is in, or waits; most have none, and then nothing is locked."""
    values = (mac, fingerprint)
    if tx.row("SELECT 1 FROM refused_joins WHERE mac = %s AND fingerprint = %s", values):
        tx.change("DELETE FROM refused_joins WHERE mac = %s AND fingerprint = %s", values)


def list_refusals(tx: Transaction) -> list[RefusedJoin]:
    """Return the joins that were refused within REFUSED_FOR, the newest first."""
    rows = tx.rows(
        "SELECT mac, fingerprint, hostname, agent_version, address, code, detail, times, refused_at "
        "FROM refused_joins WHERE refused_at > %s ORDER BY refused_at DESC",
        (tx.now() - REFUSED_FOR,),
    )
    report = ("hostname", "agent_version", "address")
    return [
        RefusedJoin(
            report=Report(*(row[name] for name in report)),
            **{name: value for name, value in row.items() if name not in report},
        )
        for row in rows
    ]

"""What the relay reads (robots, rights, credentials) and writes (sessions, audit lines, and what `control` has).

Used by the relay alone, with account relay: it reads views and writes tables that nobody else writes.
Times are aware datetimes in UTC. Nothing here decides who may do what.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property

from robotether_common.services import SERVICES, ServiceName
from robotether_common.session import HelpSource

from robotether_server.db import audit, control, routes
from robotether_server.db.audit import MAX_ADDRESS_LENGTH, Source
from robotether_server.db.cells import LOST_CODE
from robotether_server.db.control import DriveEntry, LeaseEnd, LeaseStart, StopEntry
from robotether_server.db.database import Row, Transaction
from robotether_server.db.routes import RelayRoute, RouteEnd
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import Level
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.robot import LevelPolicy, Policy, RobotSettings
from robotether_server.tickets import CredentialKind

log = logging.getLogger(__name__)

# For a robot whose settings cannot be read: nobody sends it anything that moves it.
LOCKED = RobotSettings(policy=Policy(drive=LevelPolicy(), manage=LevelPolicy()))

# Maximum length, that of the column of robot_sessions: a text from a robot must not make the row fail.
MAX_VERSION = 32


@dataclass(frozen=True)
class RelayRobot:
    """A robot's row, as far as the relay needs it."""

    id: int
    name: str
    state: str
    ros_port: int
    video_port: int
    mac: str = ""
    agent_version: str | None = None
    # None: no forward to the robot's own sshd.
    shell_port: int | None = None
    # The key that may log in, and the one before it, whose connections live on.
    fingerprint: str | None = None
    previous_fingerprint: str | None = None
    # The agent is asked for a new key.
    rotate_key: bool = False
    settings: RobotSettings = robot_settings.DEFAULTS
    site: str | None = None
    # Of a machine with this robot's MAC and a key that is not the robot's: waiting, rejected, or None.
    other_key: str | None = None

    @cached_property
    def ports(self) -> Mapping[ServiceName, int | None]:
        """The server's port of each service; None: it is off."""
        return {service.name: getattr(self, service.port_member) for service in SERVICES}


@dataclass(frozen=True)
class Changes:
    """Texts that differ whenever robots or rights, or logins or tokens, have changed; and the routes that last."""

    rights: str
    credentials: str
    routes: tuple[RelayRoute, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """All robots and all rights in force, of one point in time."""

    robots: Mapping[int, RelayRobot]
    grants: Mapping[tuple[int, int], Level]
    rights: str = ""

    @cached_property
    def by_name(self) -> Mapping[str, RelayRobot]:
        """Robots by their names."""
        return {robot.name: robot for robot in self.robots.values()}

    @cached_property
    def by_mac(self) -> Mapping[str, RelayRobot]:
        """Robots by their MACs."""
        return {robot.mac: robot for robot in self.robots.values()}

    def meant(self, name: str, mac: str | None) -> RelayRobot | None:
        """Return the robot with this MAC, whatever its name is by now; without one that of the name."""
        with_mac = None if mac is None else self.by_mac.get(mac)
        return with_mac or self.by_name.get(name)

    def level(self, user_id: int, robot_id: int) -> Level | None:
        """What the user may do with the robot, at most; None: not even see it."""
        if user_id == RECORDER.id:
            return "observe"
        return self.grants.get((user_id, robot_id))

    def visible(self, user_id: int) -> list[RelayRobot]:
        """The robots that the user may see, by name."""
        robots = self.robots.values()
        seen = [robot for robot in robots if self.level(user_id, robot.id) is not None]
        return sorted(seen, key=lambda robot: robot.name)


@dataclass(frozen=True)
class Credential:
    """A login or an API token, as the SHA-256 that the database keeps."""

    kind: CredentialKind
    digest: bytes


@dataclass(frozen=True)
class RelayUser:
    """Who a credential belongs to."""

    id: int
    name: str


@dataclass(frozen=True)
class RelayRequest:
    """An open request as the relay sees it: `user` has its robot reserved for `left_s`; None: nobody has.

    `waited_s`: since it was made, or let go by who had accepted it.
    """

    robot_id: int
    state: str
    age_s: float
    waited_s: float
    user: RelayUser | None
    left_s: float | None


# The stack's own recorder: it observes every robot, and nobody logs in as it. Numbers of users begin with 1.
RECORDER = RelayUser(0, "recorder")


@dataclass
class SessionEntry:
    """A robot's session; written when it begins, again when something of it changes."""

    robot_id: int
    started_at: datetime
    address: str
    agent_version: str | None = None
    ros_exposed: bool = False
    epoch: int = 0
    ended_at: datetime | None = None
    end_code: str | None = None
    row_id: int | None = None


@dataclass(frozen=True)
class AuditEntry:
    """A line of the audit log."""

    at: datetime
    actor: str
    kind: str
    robot: str | None = None
    address: str | None = None
    details: Mapping[str, object] = field(default_factory=dict)


@dataclass
class HelpEntry:
    """A robot's call for help; one object a source, so that the newest alone is written."""

    robot_id: int
    source: HelpSource
    reason: str
    priority: int
    pool: str = ""


@dataclass(frozen=True)
class FormerSessions:
    """All sessions, drives and leases that a relay of this cell left open before."""

    before: datetime


Entry = (
    SessionEntry
    | AuditEntry
    | HelpEntry
    | FormerSessions
    | DriveEntry
    | LeaseStart
    | LeaseEnd
    | StopEntry
    | RouteEnd
)

_CREDENTIAL_VIEWS: Mapping[CredentialKind, str] = {"login": "relay_logins", "token": "relay_tokens"}


def changes(tx: Transaction) -> Changes:
    """Read the texts that change with every change of the fleet; cheap enough for once a second."""
    row = tx.row("SELECT version FROM relay_changes") or {}
    robots, users, grants, *credentials = str(row.get("version", "//")).split("/")
    return Changes(
        rights="/".join((robots, users, grants)),
        credentials="/".join((users, *credentials)),
        routes=routes.read_lasting(tx),
    )


def load(tx: Transaction) -> Snapshot:
    """Read robots and rights, all as of the version in it; must be the first read of its transaction.

    If they were newer, a grant that is added and deleted meanwhile would stay: deleting it restores this version.
    """
    tx.change("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
    rights = changes(tx).rights
    robots = tx.rows(
        "SELECT id, name, state, ros_port, video_port, mac, agent_version, shell_port,"
        " fingerprint, previous_fingerprint, rotate_key, settings, site, other_key FROM relay_robots"
    )
    grants = tx.rows("SELECT user_id, robot_id, level FROM relay_grants")
    return Snapshot(
        robots={row["id"]: _robot_of(row) for row in robots},
        grants={(row["user_id"], row["robot_id"]): row["level"] for row in grants},
        rights=rights,
    )


def _robot_of(row: Row) -> RelayRobot:
    # MariaDB has no truth values of its own.
    rotate_key, settings = bool(row["rotate_key"]), _settings_of(row)
    return RelayRobot(**{**row, "rotate_key": rotate_key, "settings": settings})


def _settings_of(row: Row) -> RobotSettings:
    try:
        return robot_settings.parse(json.loads(row["settings"]))
    except (FieldInvalidError, ValueError, RecursionError) as problem:
        # Somebody wrote the row past the page; what it was to limit is not known.
        log.warning("robot %s: its settings are locked until mended: %s", row["name"], problem)
        return LOCKED


def last_seen(tx: Transaction) -> list[tuple[int, datetime, str | None]]:
    """Read since when and why each robot that has ever connected is offline; a dead cell's, since the cell is."""
    # Of each robot its newest session, by the index: a relay begins with this, and there may be millions.
    rows = tx.rows(
        "SELECT s.robot_id, COALESCE(s.ended_at, c.heartbeat_at, CURRENT_TIMESTAMP(6)) AS since,"  # noqa: S608
        f" {LOST_CODE} AS end_code"
        " FROM (SELECT MAX(id) AS id FROM robot_sessions GROUP BY robot_id) newest"
        " JOIN robot_sessions s ON s.id = newest.id LEFT JOIN cells c ON c.name = s.cell"
    )
    return [(row["robot_id"], row["since"], row["end_code"]) for row in rows]


def users_of(tx: Transaction, credentials: Collection[Credential]) -> dict[Credential, RelayUser]:
    """Read who these credentials belong to; those that no longer hold are left out."""
    users: dict[Credential, RelayUser] = {}
    for kind, view in _CREDENTIAL_VIEWS.items():
        digests = [credential.digest for credential in credentials if credential.kind == kind]
        sql = f"SELECT token_hash, user_id, user_name FROM {view} WHERE token_hash IN %s"  # noqa: S608 - the module's own text
        for row in tx.rows(sql, (digests,)) if digests else ():
            user = RelayUser(id=row["user_id"], name=row["user_name"])
            users[Credential(kind, bytes(row["token_hash"]))] = user
    return users


def ask_for_help(
    tx: Transaction, robot_id: int, *, source: str, reason: str, priority: int, pool: str
) -> tuple[int | None, bool]:
    """Ask for help as a robot; return the open request's id and whether it is new.

    None: the robot has as many open requests as it may. Texts of any kind are taken.
    """
    row = tx.row(
        "CALL ask_for_help(%s, %s, %s, %s, %s)", (robot_id, source, reason, priority, pool)
    )
    return (None, False) if row is None else (row["id"], bool(row["is_new"]))


def read_requests(tx: Transaction) -> list[RelayRequest]:
    """Read the open requests for help, without those of disabled robots, which are offered to nobody."""
    rows = tx.rows(
        "SELECT robot_id, h.state, age_s, waited_s, user_id, user_name, left_s FROM relay_requests h"
        " JOIN relay_robots r ON r.id = robot_id AND r.state = 'active'"
    )
    return [
        RelayRequest(
            robot_id=row["robot_id"],
            state=row["state"],
            age_s=row["age_s"],
            waited_s=row["waited_s"],
            user=None if row["user_id"] is None else RelayUser(row["user_id"], row["user_name"]),
            left_s=row["left_s"],
        )
        for row in rows
    ]


def write(tx: Transaction, entries: Iterable[Entry], cell: str | None = None) -> dict[int, int]:
    """Write entries of a cell in their order, but audit lines last; return the new rows' ids by the entry's place.

    The caller sets `row_id` from it after the commit: before that the row may yet be rolled back.
    """
    new_rows: dict[int, int] = {}
    # Each robot's lines form a chain, whose lock the first of them takes: so all relays take these locks briefly, and
    # in one order.
    ordered = sorted(enumerate(entries), key=lambda item: _chain_key(item[1]))
    for place, entry in ordered:
        row_id = _write_one(tx, entry, cell)
        if row_id is not None:
            new_rows[place] = row_id
    return new_rows


def _chain_key(entry: Entry) -> tuple[bool, str]:
    match entry:
        case AuditEntry():
            return True, entry.robot or ""
        case RouteEnd():
            return True, routes.audited_robot(entry.source, entry.target)
    return False, ""


def _write_one(tx: Transaction, entry: Entry, cell: str | None) -> int | None:
    """Write one entry; return the id of a new row that will be written again."""
    match entry:
        case SessionEntry():
            return _write_session(tx, entry, cell)
        case DriveEntry():
            return control.write_drive(tx, entry, cell)
        case AuditEntry():
            source = Source(entry.actor, entry.address)
            audit.record(tx, source, entry.kind, entry.robot, entry.at, **entry.details)
        case HelpEntry():
            ask_for_help(tx, **vars(entry))
        case FormerSessions():
            _end_former_sessions(tx, entry, cell)
            control.end_former(tx, entry.before, cell)
        case LeaseStart():
            control.start_lease(tx, entry, cell)
        case LeaseEnd():
            control.end_lease(tx, entry)
        case StopEntry():
            control.write_stop(tx, entry)
        case RouteEnd():
            routes.write_end(tx, entry)
    return None


def _end_former_sessions(tx: Transaction, entry: FormerSessions, cell: str | None) -> None:
    tx.change(
        "UPDATE robot_sessions SET ended_at = CURRENT_TIMESTAMP(6), end_code = 'relay_restarted'"
        " WHERE ended_at IS NULL AND started_at < %s AND (cell = %s OR cell IS NULL)",
        (entry.before, cell),
    )


def _write_session(tx: Transaction, entry: SessionEntry, cell: str | None) -> int | None:
    if entry.row_id is None:
        row_id = _add_session(tx, entry, cell)
        _audit_version(tx, entry, row_id)
        return row_id
    row = tx.row("SELECT agent_version FROM robot_sessions WHERE id = %s", (entry.row_id,))
    tx.update("robot_sessions", entry.row_id, _session_progress(entry))
    if row is not None and row["agent_version"] is None:
        _audit_version(tx, entry, entry.row_id)
    return None


def _audit_version(tx: Transaction, entry: SessionEntry, row_id: int) -> None:
    """Note the version of agent and guard, if it is another one than in the robot's session before."""
    version = _cut(entry.agent_version, MAX_VERSION)
    if version is not None:
        tx.change(
            "INSERT INTO audit_events (actor, kind, robot, details)"
            " SELECT r.name, 'robot_version', r.name, JSON_OBJECT('was', s.agent_version, 'agent_version', %s)"
            " FROM relay_robots r LEFT JOIN robot_sessions s ON s.id = (SELECT MAX(p.id) FROM robot_sessions p"
            " WHERE p.robot_id = r.id AND p.id < %s AND p.agent_version IS NOT NULL)"
            " WHERE r.id = %s AND NOT s.agent_version <=> %s",
            (version, row_id, entry.robot_id, version),
        )


def _add_session(tx: Transaction, entry: SessionEntry, cell: str | None) -> int:
    return tx.add(
        "robot_sessions",
        {
            "robot_id": entry.robot_id,
            "cell": cell,
            "started_at": entry.started_at,
            "address": entry.address[:MAX_ADDRESS_LENGTH],
            **_session_progress(entry),
        },
    )


def _session_progress(entry: SessionEntry) -> dict[str, object]:
    """Return the columns that change while the session lasts."""
    return {
        "epoch": entry.epoch,
        "agent_version": _cut(entry.agent_version, MAX_VERSION),
        "ros_exposed": entry.ros_exposed,
        "ended_at": entry.ended_at,
        "end_code": entry.end_code,
    }


def _cut(text: str | None, length: int) -> str | None:
    return None if text is None else text[:length]

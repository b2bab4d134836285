"""Leases with their numbers, drives and stops, as the relay writes and reads them.

Used by the relay alone, with account relay. Nothing here decides who drives. A robot or user that was
removed meanwhile is no error: what is written stays, or there is nothing left to write.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import datetime

from robotether_server.db.audit import MAX_ADDRESS_LENGTH
from robotether_server.db.database import Transaction
from robotether_server.problems import RecordMissingError

MAX_NAME = 63
MAX_REASON = 255


@dataclass(frozen=True)
class LeaseStart:
    """A lease that began while the database was away."""

    robot_id: int
    fence: int
    user_id: int
    user: str
    since: datetime


@dataclass(frozen=True)
class LeaseEnd:
    """A lease that is over."""

    robot_id: int
    fence: int
    ended_at: datetime


# When a robot was stopped, and by whom: no two stops of a robot have both in common.
StopId = tuple[datetime, str]


@dataclass(frozen=True)
class Stop:
    """A robot that is stopped; `by` is a user's name, or what the robot itself reported (relay/control/stops.py)."""

    robot_id: int
    at: datetime
    by: str
    reason: str | None = None

    @property
    def id(self) -> StopId:
        """What names the stop among those of its robot."""
        return self.at, self.by


@dataclass
class StopEntry:
    """The stop of a robot, None: not stopped; one object a robot, so that only its newest state is written.

    `ended` are the last stops that releases ended: another cell may have written one that none of them did.
    """

    robot_id: int
    stop: Stop | None = None
    ended: tuple[StopId, ...] = field(default=(), compare=False)


@dataclass
class DriveEntry:
    """A drive; written while it lasts and at its end."""

    robot_id: int
    robot: str
    user: str
    fence: int
    started_at: datetime
    address: str | None = None
    ended_at: datetime | None = None
    end_code: str | None = None
    distance_m: float = 0.0
    # None: of a robot that is steered nobody here knows it.
    turned_rad: float | None = 0.0
    top_speed_m_s: float = 0.0
    top_turn_rad_s: float | None = 0.0
    messages: int = 0
    dropped_old: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    stops: int = 0
    # None: nobody measured it.
    latency_p50_ms: float | None = None
    latency_p95_ms: float | None = None
    # Of commands that name what the driver saw; None: the robot's guard reported none.
    seen_p50_ms: float | None = None
    seen_p95_ms: float | None = None
    seen_p99_ms: float | None = None
    seen_max_ms: float | None = None
    seen_unknown: int | None = None
    slowed_s: float | None = None
    bytes: int = 0
    frames: int = 0
    frame_bytes: int = 0
    viewed_s: float = 0.0
    # The robot's key and its agent's version when the drive began, and the relay's; None: unknown.
    robot_key: str | None = None
    agent_version: str | None = None
    server_version: str | None = None
    # Where the robot was, by the pose topic of its geofence; None: unknown.
    start_x_m: float | None = None
    start_y_m: float | None = None
    end_x_m: float | None = None
    end_y_m: float | None = None
    row_id: int | None = None


@dataclass(frozen=True)
class StoredControl:
    """What a relay finds when it starts: each robot's newest number, and who is stopped."""

    fences: dict[int, int]
    stops: list[Stop]


def read_stored(tx: Transaction, robot_id: int | None = None) -> StoredControl:
    """Read what outlived the relay before this one, or what other cells wrote of one robot."""
    of_one, values = ("", ()) if robot_id is None else (" WHERE robot_id = %s", (robot_id,))
    fences = tx.rows(f"SELECT robot_id, fence FROM control_leases{of_one}", values)  # noqa: S608 - the module's own text
    stops = tx.rows(
        f"SELECT robot_id, stopped_at AS at, by_name AS `by`, reason FROM robot_stops{of_one}",  # noqa: S608 - as above
        values,
    )
    return StoredControl(
        {row["robot_id"]: row["fence"] for row in fences}, [Stop(**row) for row in stops]
    )


@dataclass(frozen=True)
class NewLease:
    """A drive that is about to begin; `above` is the newest number that the relay knows."""

    robot_id: int
    user_id: int
    user: str
    since: datetime
    above: int = 0


def next_fence(tx: Transaction, lease: NewLease, cell: str | None = None) -> int:
    """Begin a lease of a cell; return its number, which holds once the transaction is committed."""
    # A database that was restored from a copy must not give numbers that a guard has seen.
    tx.change(
        "INSERT INTO control_leases (robot_id, fence, user_id, user_name, since, cell)"
        " VALUES (%s, %s + 1, %s, %s, %s, %s) ON DUPLICATE KEY UPDATE"
        " fence = GREATEST(fence + 1, VALUES(fence)), user_id = VALUES(user_id), user_name = VALUES(user_name),"
        " since = VALUES(since), cell = VALUES(cell), ended_at = NULL",
        (lease.robot_id, lease.above, lease.user_id, lease.user[:MAX_NAME], lease.since, cell),
    )
    row = tx.row("SELECT fence FROM control_leases WHERE robot_id = %s", (lease.robot_id,))
    if row is None:
        raise RecordMissingError("cannot number the drive: the robot was removed meanwhile")
    return int(row["fence"])


def start_lease(tx: Transaction, entry: LeaseStart, cell: str | None) -> None:
    """Write a lease that has begun, unless a newer one has its row: the number there never falls."""
    # A user who was removed meanwhile has no grants.
    changes = ", ".join(
        f"{name} = IF(VALUES(fence) >= fence, VALUES({name}), {name})"
        for name in ("fence", "user_id", "user_name", "since", "cell", "ended_at")
    )
    tx.change(
        "INSERT INTO control_leases (robot_id, fence, user_id, user_name, since, cell, ended_at)"  # noqa: S608 - the module's own text
        " SELECT id, %s, (SELECT MAX(user_id) FROM relay_grants WHERE user_id = %s), %s, %s, %s, NULL"
        f" FROM relay_robots WHERE id = %s ON DUPLICATE KEY UPDATE {changes}",
        (entry.fence, entry.user_id, entry.user[:MAX_NAME], entry.since, cell, entry.robot_id),
    )


def end_lease(tx: Transaction, entry: LeaseEnd) -> None:
    """Write that a lease is over, unless a newer one has its row."""
    tx.change(
        "UPDATE control_leases SET ended_at = %s WHERE robot_id = %s AND fence = %s",
        (entry.ended_at, entry.robot_id, entry.fence),
    )


def end_former(tx: Transaction, before: datetime, cell: str | None) -> None:
    """End drives and leases that a relay of this cell left open before, when they were last written.

    Those without a cell are of a relay from before there were cells. The audit log gets their end now, and until when
    they lasted at least.
    """
    tx.change(
        "INSERT INTO audit_events (actor, kind, robot, details)"
        " SELECT l.user_name, 'drive_ended', r.name, JSON_OBJECT('end_code', 'relay_restarted', 'fence', l.fence,"
        " 'at_least_until', DATE_FORMAT(COALESCE(d.ended_at, d.updated_at, l.since),"
        " '%%Y-%%m-%%dT%%H:%%i:%%s.%%f+00:00'))"
        " FROM control_leases l JOIN relay_robots r ON r.id = l.robot_id"
        " LEFT JOIN drives d ON d.robot_id = l.robot_id AND d.fence = l.fence"
        " WHERE l.ended_at IS NULL AND l.since < %s AND (l.cell = %s OR l.cell IS NULL) ORDER BY r.name",
        (before, cell),
    )
    tx.change(
        "UPDATE drives SET ended_at = updated_at, end_code = 'relay_restarted'"
        " WHERE ended_at IS NULL AND started_at < %s AND (cell = %s OR cell IS NULL)",
        (before, cell),
    )
    tx.change(
        "UPDATE control_leases SET ended_at = CURRENT_TIMESTAMP(6)"
        " WHERE ended_at IS NULL AND since < %s AND (cell = %s OR cell IS NULL)",
        (before, cell),
    )


def write_stop(tx: Transaction, entry: StopEntry) -> None:
    """Write whether a robot is stopped; a stop that another cell wrote goes only when it has ended."""
    for at, by in entry.ended:
        tx.change(
            "DELETE FROM robot_stops WHERE robot_id = %s AND stopped_at = %s AND by_name = %s",
            (entry.robot_id, at, by[:MAX_NAME]),
        )
    stop = entry.stop
    if stop is None:
        return
    reason = None if stop.reason is None else stop.reason[:MAX_REASON]
    tx.change(
        "INSERT INTO robot_stops (robot_id, stopped_at, by_name, reason)"
        " SELECT id, %s, %s, %s FROM relay_robots WHERE id = %s"
        " ON DUPLICATE KEY UPDATE stopped_at = VALUES(stopped_at), by_name = VALUES(by_name),"
        " reason = VALUES(reason)",
        (stop.at, stop.by[:MAX_NAME], reason, stop.robot_id),
    )


# Members of a drive that are written once; all others change while it lasts.
FIXED = ("robot_id", "robot", "user", "fence", "started_at", "address", "row_id")
# Columns that have not the name of their member.
COLUMNS = {"frames": "pictures", "frame_bytes": "picture_bytes"}


def write_drive(tx: Transaction, drive: DriveEntry, cell: str | None) -> int | None:
    """Write the current record of a drive; return the id of a new row."""
    if drive.row_id is None:
        return _add_drive(tx, drive, cell)
    tx.update("drives", drive.row_id, _progress(drive))
    return None


def _add_drive(tx: Transaction, drive: DriveEntry, cell: str | None) -> int:
    progress = _progress(drive)
    values = {
        "robot": drive.robot[:MAX_NAME],
        "user_name": drive.user[:MAX_NAME],
        "fence": drive.fence,
        "cell": cell,
        "started_at": drive.started_at,
        "address": None if drive.address is None else drive.address[:MAX_ADDRESS_LENGTH],
        **progress,
    }
    places = ", ".join(f"%({column})s" for column in values)
    changes = ", ".join(f"{column} = VALUES({column})" for column in progress)
    # The same row again: the answer to the first writing was lost with its connection, or its relay was killed since.
    return tx.insert(
        f"INSERT INTO drives ({', '.join(values)}, robot_id) VALUES"  # noqa: S608 - the module's own text
        f" ({places}, (SELECT id FROM relay_robots WHERE id = %(robot_id)s))"
        f" ON DUPLICATE KEY UPDATE id = LAST_INSERT_ID(id), {changes}",
        values | {"robot_id": drive.robot_id},
    )


def _progress(drive: DriveEntry) -> dict[str, object]:
    """Return the columns that change while the drive lasts."""
    values = vars(drive) | {"refused": json.dumps(drive.refused)}
    return {COLUMNS.get(name, name): value for name, value in values.items() if name not in FIXED}

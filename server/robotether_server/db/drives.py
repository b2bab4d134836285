"""Drives as web shows them: who drove which robot, and how. Only the relay writes them (db/control.py)."""

import datetime as dt
import json
from dataclasses import asdict, dataclass, fields

from robotether_server.db import cells
from robotether_server.db.database import Transaction
from robotether_server.db.users import User
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import Amount, Count, Timestamp

# A command other than zero went to the robot.
MOVED = "(top_speed_m_s > 0 OR top_turn_rad_s > 0)"


@dataclass(frozen=True)
class Drive:
    """One drive; `ended_at` is None while it lasts.

    Distance, turn and speeds are those commanded. `dropped_old` counts commands that came too late, `refused` the
    operations that the policy refused, by kind, and what the robot's guard refused (`guard_...`). `latency_...` are
    round trips from the driver to the robot. `seen_..._ms` is how old was what the driver saw when a command that moved
    the robot reached it, by the robot's clock, and `seen_unknown` the number of those of which nobody knows; `slowed_s`
    is the time for which the robot was slowed for that. `bytes` are rosbridge's in both directions, `frames` and
    `frame_bytes` the driver's video, `viewed_s` the time with a video open. `robot_key` is the
    fingerprint of the robot's key, `agent_version` that of its agent with its guard, both at the start;
    `start_x_m`, `start_y_m`, `end_x_m` and `end_y_m` are where the robot was, by the pose topic of its geofence.
    None: not measured or not known; the turn: not known, as of a car.
    """

    id: Count
    robot: str
    user: str
    fence: Count
    started_at: Timestamp
    ended_at: Timestamp | None
    end_code: str | None
    distance_m: Amount
    turned_rad: Amount | None
    top_speed_m_s: Amount
    top_turn_rad_s: Amount | None
    messages: Count
    dropped_old: Count
    refused: dict[str, Count]
    stops: Count
    address: str | None
    latency_p50_ms: Amount | None
    latency_p95_ms: Amount | None
    seen_p50_ms: Amount | None
    seen_p95_ms: Amount | None
    seen_p99_ms: Amount | None
    seen_max_ms: Amount | None
    seen_unknown: Count | None
    slowed_s: Amount | None
    bytes: Count | None
    frames: Count | None
    frame_bytes: Count | None
    viewed_s: Amount | None
    robot_key: str | None
    agent_version: str | None
    server_version: str | None
    start_x_m: float | None
    start_y_m: float | None
    end_x_m: float | None
    end_y_m: float | None

    @property
    def lasted_s(self) -> float | None:
        """How long it lasted; None: it still does."""
        return (self.ended_at - self.started_at).total_seconds() if self.ended_at else None

    @property
    def frames_per_s(self) -> float | None:
        """The frame rate while a video was open; None: none was."""
        if not self.frames or not self.viewed_s:
            return None
        return self.frames / self.viewed_s


# Where a member is not the column of its name.
SOURCES = {
    "user": "s.user_name",
    "ended_at": f"IF({cells.IS_LOST}, s.updated_at, s.ended_at)",
    "end_code": cells.LOST_CODE,
    "frames": "s.pictures",
    "frame_bytes": "s.picture_bytes",
}
COLUMNS = ", ".join(
    f"{SOURCES.get(field.name, f's.{field.name}')} AS `{field.name}`" for field in fields(Drive)
)


@dataclass(frozen=True)
class DriveSearch:
    """A filter of drives: all given members must match; times compare with the start.

    `robot`: a name that it has now, or had then; `mac`: one that it has now. A drive that never moved the robot is
    found only by its `fence`.
    """

    robot: str | None = None
    mac: str | None = None
    user: str | None = None
    since: dt.datetime | None = None
    until: dt.datetime | None = None
    fence: int | None = None


CONDITIONS = {
    "robot": "(robot = %(robot)s OR robot_id = (SELECT id FROM robots WHERE name = %(robot)s))",
    "mac": "robot_id = (SELECT id FROM robots WHERE mac = %(mac)s)",
    "user": "user_name = %(user)s",
    "since": "started_at >= %(since)s",
    "until": "started_at < %(until)s",
    "fence": "fence = %(fence)s",
    "before": "id < %(before)s",
}


def get(tx: Transaction, viewer: User, drive_id: int) -> Drive:
    """Return one drive; raise RecordMissingError when there is none that the viewer may see."""
    drives = _select(tx, viewer, "id = %(id)s", {"id": drive_id}, 1)
    if not drives:
        raise RecordMissingError(f"cannot show drive {drive_id}: there is none that you may see")
    return drives[0]


def find(
    tx: Transaction,
    viewer: User,
    search: DriveSearch,
    *,
    before: int | None = None,
    limit: int = 100,
) -> list[Drive]:
    """Return the matching drives that the viewer may see, newest first.

    Admins see all; others see their own, and all drives of the robots that they manage now. What a removed user of the
    same name drove is not their own.
    """
    values = asdict(search) | {"before": before}
    parameters = {name: value for name, value in values.items() if value is not None}
    moved = MOVED if search.fence is None else "TRUE"
    conditions = " AND ".join((moved, *(CONDITIONS[name] for name in parameters)))
    return _select(tx, viewer, conditions, parameters, limit)


def _select(
    tx: Transaction, viewer: User, conditions: str, parameters: dict[str, object], limit: int
) -> list[Drive]:
    rows = tx.rows(
        f"SELECT {COLUMNS} FROM drives s WHERE "  # noqa: S608 - the texts are the module's own
        "(%(is_admin)s OR (user_name = %(own)s AND started_at >= (SELECT created_at FROM users WHERE id = %(own_id)s))"
        " OR robot_id IN (SELECT robot_id FROM relay_grants WHERE user_id = %(own_id)s AND level = 'manage'))"
        f" AND {conditions} ORDER BY id DESC LIMIT %(limit)s",
        parameters
        | {"is_admin": viewer.is_admin, "own": viewer.name, "own_id": viewer.id, "limit": limit},
    )
    return [Drive(**row | {"refused": json.loads(row["refused"])}) for row in rows]

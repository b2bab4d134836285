"""Recordings of robots: what web asks for, and what the recorder writes of them; each writes its own columns.

sql/0027_recordings.sql says which. The file of a recording is named by its number.
"""

import datetime as dt
import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from typing import Literal

from robotether_server.db.cells import is_current
from robotether_server.db.database import Row, Transaction
from robotether_server.db.grants import LEVELS
from robotether_server.db.users import User
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import Count, Level, RobotName, Timestamp, UserName

RecordingCause = Literal["asked", "driven", "always", "on_stop"]
RecordingState = Literal["requested", "recording", "interrupted", "ended"]
# Time after which a recording that its recorder writes nothing more of counts as interrupted.
PROGRESS_WITHIN_S = 30
# Time limit for the recorder to begin what somebody asks for, by the database's clock.
BEGIN_WITHIN_S = 60
# Maximum length of a recording that somebody asked for, with those that continue it.
MAX_ASKED_S = 4 * 3600
# Time within which a person's requests for pieces of a recording are one download.
DOWNLOAD_WITHIN_S = 3600


@dataclass(frozen=True)
class Recording:
    """A recording; null: not yet, or unknown.

    `cause`: who or what had it made: asked (a person), driven, always or on_stop (the robot's settings).
    `asked_by`: who asked, null for the others. `drivers`: who drove during it, as far as it is recorded. `state`:
    requested, recording, ended, or interrupted: nothing is heard of the recorder. `messages_left_out`: of topics
    for which the file had no room. `topics_left_out`: topics that the file lacks, at least for a part of its time,
    the first of many: it has at most 16 at a time and 200 in all, and none that its policy hides from observers.
    `cell`: whose machine has the file.
    """

    id: Count
    robot: RobotName
    cause: RecordingCause
    state: RecordingState
    asked_by: UserName | None
    drivers: list[UserName]
    asked_at: Timestamp
    started_at: Timestamp | None
    ended_at: Timestamp | None
    end_code: str | None
    bytes: Count
    messages: Count
    messages_left_out: Count | None
    topics_left_out: list[str] | None
    cell: str | None

    @property
    def may_lack_others(self) -> bool:
        """Whether the file may lack more topics than are named."""
        return len(self.topics_left_out or ()) >= MAX_TOPICS_LEFT_OUT

    @property
    def lasted_s(self) -> float | None:
        """How long it lasted; None: it still does, or has not begun."""
        if self.started_at is None or self.ended_at is None:
            return None
        return (self.ended_at - self.started_at).total_seconds()


@dataclass(frozen=True)
class RecordingRow:
    """A recording as the recorder needs it. `may_go_on`: who asked may still drive the robot.

    `is_late`: it was to begin by now. `progress_at`: when its recorder last wrote of it. `asked_s`: time since somebody
    asked for it, or for the first that it continues. `is_cell_removed`: it was ended for a recorder that was lost.
    """

    id: int
    robot_id: int
    robot: str
    cause: RecordingCause
    asked_by: str | None
    is_late: bool
    is_stop_requested: bool
    is_delete_requested: bool
    started_at: dt.datetime | None
    ended_at: dt.datetime | None
    progress_at: dt.datetime | None
    asked_s: int
    may_go_on: bool
    is_cell_removed: bool


@dataclass(frozen=True)
class RecordableRobot:
    """A robot that may be recorded, when by its settings (None: never), and the cameras of its page."""

    id: int
    name: str
    recording_when: str | None = None
    cameras: tuple[str, ...] = ()


@dataclass(frozen=True)
class Progress:
    """What the recorder writes of a recording while it lasts.

    None of what is left out: unknown; of drivers: those that were written before.
    """

    bytes: int
    messages: int
    drivers: Sequence[str] | None = ()
    messages_left_out: int | None = 0
    topics_left_out: Sequence[str] | None = ()


# Maximum number of topics that a recording names as left out.
MAX_TOPICS_LEFT_OUT = 50
_IS_NEW = is_current("asked_at", BEGIN_WITHIN_S)
# Rights go by the robot's number. A recording of a robot that is gone is the admins'.
_OF_VIEWER = (
    "(%(is_admin)s OR robot_id IN"
    " (SELECT robot_id FROM relay_grants WHERE user_id = %(viewer_id)s AND level IN %(levels)s))"
)
_STATE = (
    f"CASE WHEN ended_at IS NOT NULL THEN 'ended' WHEN started_at IS NULL AND {_IS_NEW} THEN 'requested'"
    f" WHEN {is_current('progress_at', PROGRESS_WITHIN_S)} THEN 'recording' ELSE 'interrupted' END"
)
_COLUMNS = ", ".join(
    f"{_STATE} AS state" if field.name == "state" else field.name for field in fields(Recording)
)


def is_asked_for(tx: Transaction, robot_id: int) -> bool:
    """Return whether a recording that somebody asked for goes on, or is about to begin."""
    row = tx.row(
        "SELECT 1 FROM recordings WHERE robot_id = %(robot_id)s AND cause = 'asked'"  # noqa: S608 - the module's own texts
        " AND delete_requested_at IS NULL AND deleted_at IS NULL"
        f" AND {_STATE} IN ('recording', 'requested') LIMIT 1",
        {"robot_id": robot_id},
    )
    return row is not None


def ask(tx: Transaction, robot_id: int, robot: str, user: User) -> int:
    """Ask the recorder for a recording; return its number."""
    return tx.insert(
        "INSERT INTO recordings (robot_id, robot, cause, asked_by_id, asked_by)"
        " VALUES (%s, %s, 'asked', %s, %s)",
        (robot_id, robot, user.id, user.name),
    )


def find(
    tx: Transaction,
    viewer: User,
    level: Level,
    *,
    robot: str | None = None,
    mac: str | None = None,
    before: int | None = None,
    limit: int = 100,
) -> list[Recording]:
    """Return the recordings of robots on which the viewer has that level, newest first; not those that are deleted.

    `robot`: a name that it has now, or had then. `mac`: one that it has now.
    """
    conditions = ["delete_requested_at IS NULL", "deleted_at IS NULL"]
    values: dict[str, object] = {"robot": robot, "mac": mac, "before": before}
    if robot is not None:
        conditions.append(
            "(robot = %(robot)s OR robot_id = (SELECT id FROM robots WHERE name = %(robot)s))"
        )
    if mac is not None:
        conditions.append("robot_id = (SELECT id FROM robots WHERE mac = %(mac)s)")
    if before is not None:
        conditions.append("id < %(before)s")
    return _select(tx, viewer, level, conditions, values, limit=limit)


def get(tx: Transaction, viewer: User, level: Level, recording_id: int) -> Recording:
    """Return one recording; raise RecordMissingError when there is none on whose robot the viewer has that level."""
    conditions = ["delete_requested_at IS NULL", "deleted_at IS NULL", "id = %(id)s"]
    recordings = _select(tx, viewer, level, conditions, {"id": recording_id}, limit=1)
    if not recordings:
        raise RecordMissingError(
            f"cannot find recording {recording_id}: there is none for you, or it is deleted"
        )
    return recordings[0]


def _select(
    tx: Transaction,
    viewer: User,
    level: Level,
    conditions: Sequence[str],
    values: dict[str, object],
    *,
    limit: int,
) -> list[Recording]:
    rows = tx.rows(
        f"SELECT {_COLUMNS} FROM recordings"  # noqa: S608 - the texts are the module's own
        f" WHERE {_OF_VIEWER} AND {' AND '.join(conditions)} ORDER BY id DESC LIMIT %(limit)s",
        values
        | {
            "is_admin": viewer.is_admin,
            "viewer_id": viewer.id,
            "levels": LEVELS[LEVELS.index(level) :],
            "limit": limit,
        },
    )
    return [_recording(row) for row in rows]


def _recording(row: Row) -> Recording:
    left_out = row["topics_left_out"]
    topics = None if left_out is None else json.loads(left_out)
    return Recording(**row | {"drivers": (row["drivers"] or "").split(), "topics_left_out": topics})


def find_later(tx: Transaction, recording_id: int) -> int | None:
    """Return the recording that goes on in place of one that ended so."""
    row = tx.row(
        "SELECT later.id FROM recordings r JOIN recordings later ON later.robot_id = r.robot_id"
        " AND later.first_asked_at = COALESCE(r.first_asked_at, r.asked_at) AND later.id > r.id WHERE r.id = %s"
        " AND later.delete_requested_at IS NULL AND later.deleted_at IS NULL ORDER BY later.id LIMIT 1",
        (recording_id,),
    )
    return None if row is None else int(row["id"])


def request_stop(tx: Transaction, recording_id: int) -> None:
    """Ask the recorder to end a recording."""
    tx.change(
        "UPDATE recordings SET stop_requested_at = COALESCE(stop_requested_at, CURRENT_TIMESTAMP(6))"
        " WHERE id = %s",
        (recording_id,),
    )


def request_deletion(tx: Transaction, recording_id: int) -> None:
    """Ask the recorder to delete a recording; nobody is shown it any longer."""
    tx.change(
        "UPDATE recordings SET delete_requested_at = CURRENT_TIMESTAMP(6) WHERE id = %s",
        (recording_id,),
    )


def note_download(tx: Transaction, recording_id: int, user_id: int) -> bool:
    """Note that a user gets the recording, or a piece of it; return whether that begins a download."""
    return bool(
        tx.change(
            "INSERT INTO recording_downloads (recording_id, user_id) VALUES (%s, %s)"  # noqa: S608 - the modules' own texts
            f" ON DUPLICATE KEY UPDATE begun_at = IF({is_current('begun_at', DOWNLOAD_WITHIN_S)},"
            " begun_at, CURRENT_TIMESTAMP(6))",
            (recording_id, user_id),
        )
    )


def read_open(tx: Transaction, cell: str) -> list[RecordingRow]:
    """Read what the recorder of a cell has to do with: what is asked for, lasts, or is to be deleted."""
    rows = tx.rows(
        f"SELECT r.id, r.robot_id, r.robot, r.cause, r.asked_by, NOT {_IS_NEW} AS is_late,"  # noqa: S608 - as above
        " r.started_at, r.ended_at, r.progress_at, r.stop_requested_at IS NOT NULL AS is_stop_requested,"
        " r.delete_requested_at IS NOT NULL AS is_delete_requested, r.end_code <=> 'cell_removed' AS is_cell_removed,"
        " TIMESTAMPDIFF(SECOND, COALESCE(r.first_asked_at, r.asked_at), CURRENT_TIMESTAMP(6)) AS asked_s,"
        " r.ended_at IS NOT NULL OR r.cause <> 'asked' OR EXISTS"
        " (SELECT 1 FROM relay_grants g JOIN recorder_robots b ON b.id = g.robot_id"
        " WHERE g.user_id = r.asked_by_id AND g.robot_id = r.robot_id AND g.level IN ('drive', 'manage'))"
        " AS may_go_on"
        " FROM recordings r WHERE r.deleted_at IS NULL AND (r.cell = %s OR r.cell IS NULL)"
        " AND (r.ended_at IS NULL OR r.end_code = 'cell_removed' OR r.delete_requested_at IS NOT NULL) ORDER BY r.id",
        (cell,),
    )
    flags = ("is_late", "is_stop_requested", "is_delete_requested", "may_go_on", "is_cell_removed")
    return [RecordingRow(**row | {flag: bool(row[flag]) for flag in flags}) for row in rows]


def read_robots(tx: Transaction) -> list[RecordableRobot]:
    """Read the robots that may be recorded."""
    rows = tx.rows("SELECT id, name, recording_when, cameras FROM recorder_robots")
    return [RecordableRobot(**row | {"cameras": _cameras(row["cameras"])}) for row in rows]


def begin(tx: Transaction, recording_id: int, cell: str, started_at: dt.datetime) -> bool:
    """Begin a recording that was asked for, unless another cell's recorder has; return whether it is this one's."""
    return bool(
        tx.change(
            "UPDATE recordings SET cell = %s, started_at = %s, progress_at = CURRENT_TIMESTAMP(6)"
            " WHERE id = %s AND cell IS NULL AND ended_at IS NULL",
            (cell, started_at, recording_id),
        )
    )


def add(
    tx: Transaction,
    robot: RecordableRobot,
    cause: RecordingCause,
    cell: str,
    started_at: dt.datetime,
) -> int:
    """Begin a recording by the robot's settings; return its number."""
    return tx.insert(
        "INSERT INTO recordings (robot_id, robot, cause, cell, started_at, progress_at)"
        " VALUES (%s, %s, %s, %s, %s, CURRENT_TIMESTAMP(6))",
        (robot.id, robot.name, cause, cell, started_at),
    )


def write_progress(tx: Transaction, recording_id: int, progress: Progress) -> None:
    """Write how far a recording is."""
    tx.change(
        "UPDATE recordings SET bytes = %s, messages = %s, messages_left_out = %s,"
        " drivers = COALESCE(%s, drivers), topics_left_out = %s, progress_at = CURRENT_TIMESTAMP(6) WHERE id = %s",
        (
            progress.bytes,
            progress.messages,
            progress.messages_left_out,
            # No name has a space.
            None if progress.drivers is None else " ".join(progress.drivers),
            None if progress.topics_left_out is None else json.dumps(progress.topics_left_out),
            recording_id,
        ),
    )


def end(
    tx: Transaction,
    recording_id: int,
    end_code: str,
    progress: Progress | None,
    ended_at: dt.datetime,
) -> None:
    """End a recording; `progress` None: no more is known than was written."""
    if progress is not None:
        write_progress(tx, recording_id, progress)
    tx.change(
        "UPDATE recordings SET ended_at = %s, end_code = %s WHERE id = %s",
        (ended_at, end_code, recording_id),
    )


def ask_again(tx: Transaction, recording_id: int) -> None:
    """Ask all cells' recorders for what somebody asked for, in place of one that is about to end for another reason.

    Not if that was long ago, or somebody has asked again while the recorder was away.
    """
    tx.change(
        "INSERT INTO recordings (robot_id, robot, cause, asked_by_id, asked_by, first_asked_at)"
        " SELECT r.robot_id, b.name, r.cause, r.asked_by_id, r.asked_by, COALESCE(r.first_asked_at, r.asked_at)"
        " FROM recordings r JOIN recorder_robots b ON b.id = r.robot_id WHERE r.id = %s"
        " AND r.cause = 'asked' AND r.stop_requested_at IS NULL AND r.delete_requested_at IS NULL"
        " AND r.ended_at IS NULL"
        " AND COALESCE(r.first_asked_at, r.asked_at) > CURRENT_TIMESTAMP(6) - INTERVAL %s SECOND"
        " AND NOT EXISTS (SELECT 1 FROM recordings later WHERE later.robot_id = r.robot_id AND later.id > r.id"
        " AND later.cause = 'asked' AND later.ended_at IS NULL)",
        (recording_id, MAX_ASKED_S),
    )


def note_deleted(tx: Transaction, recording_id: int) -> None:
    """The file is gone."""
    tx.change(
        "UPDATE recordings SET deleted_at = CURRENT_TIMESTAMP(6) WHERE id = %s", (recording_id,)
    )


def read_older(tx: Transaction, cell: str, before: dt.datetime) -> list[int]:
    """Read which recordings of a cell, of one that was removed, or of none, ended before a time."""
    rows = tx.rows(
        "SELECT id FROM recordings WHERE COALESCE(cell, '') NOT IN (SELECT name FROM cells WHERE name <> %s)"
        " AND ended_at < %s AND deleted_at IS NULL ORDER BY id",
        (cell, before),
    )
    return [row["id"] for row in rows]


def read_bytes_elsewhere(tx: Transaction, cell: str) -> int:
    """Read how many bytes the recordings of a site's other cells take, as they last wrote."""
    [row] = tx.rows(
        "SELECT COALESCE(SUM(bytes), 0) AS size FROM recordings WHERE deleted_at IS NULL AND cell <> %s"
        " AND cell IN (SELECT name FROM cells)",
        (cell,),
    )
    return int(row["size"])


def read_present(tx: Transaction, cell: str, recording_ids: Collection[int]) -> set[int]:
    """Read which of these recordings a cell has."""
    if not recording_ids:
        return set()
    rows = tx.rows(
        "SELECT id FROM recordings WHERE cell = %s AND id IN %s", (cell, tuple(recording_ids))
    )
    return {row["id"] for row in rows}


def _cameras(text: str | None) -> tuple[str, ...]:
    topics = json.loads(text) if text else []
    return tuple(topic for topic in topics if isinstance(topic, str))

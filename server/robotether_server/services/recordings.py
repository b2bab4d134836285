"""Recordings of robots: who may ask for one, end it, get its file, and delete it. The recorder does the rest."""

from robotether_server.db import Transaction, audit, recordings, robots, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.recordings import Recording
from robotether_server.db.users import User
from robotether_server.problems import GrantMissingError, NotPossibleError


def ask(tx: Transaction, user: User, name: str) -> Recording:
    """Ask for a recording of a robot that the user may drive; it begins within two seconds if the robot is online.

    Raises RobotUnknownError, GrantMissingError or NotPossibleError.
    """
    seen = seen_robots.require(tx, user, name, "drive", "record")
    if seen.robot.state != "active":
        raise NotPossibleError(f"cannot record robot {name}: it is {seen.robot.state}")
    # Locked: of two people who ask at once, one is the first.
    robots.get(tx, name)
    if recordings.is_asked_for(tx, seen.robot.id):
        raise NotPossibleError(
            f"cannot record robot {name}: a recording is under way; stop that first"
        )
    number = recordings.ask(tx, seen.robot.id, seen.robot.name, user)
    return recordings.get(tx, user, "drive", number)


def stop(tx: Transaction, user: User, recording_id: int) -> Recording:
    """End a recording that the user asked for, or one of a robot that the user manages; return it.

    If another goes on in its place, that is the one. Raises RecordMissingError or GrantMissingError.
    """
    recording = recordings.get(tx, user, "drive", recording_id)
    if recording.asked_by != user.name and not _manages(tx, user, recording_id):
        raise GrantMissingError(
            f"cannot stop recording {recording_id}: you neither asked for it nor manage its robot"
        )
    while (later := recordings.find_later(tx, recording.id)) is not None:
        recording = recordings.get(tx, user, "drive", later)
    recordings.request_stop(tx, recording.id)
    return recording


def delete(tx: Transaction, source: Source, user: User, recording_id: int) -> Recording:
    """Delete a recording of a robot that the user manages; one under way ends. Raises RecordMissingError."""
    recording = recordings.get(tx, user, "manage", recording_id)
    recordings.request_deletion(tx, recording_id)
    audit.record(tx, source, "recording_deleted", recording.robot, recording=recording_id)
    return recording


def view(
    tx: Transaction, source: Source, user: User, recording_id: int, *, is_noted: bool = False
) -> Recording:
    """Let the user play a recording back, by pieces of its file. Raises RecordMissingError or NotPossibleError.

    `is_noted`: the audit log gets no line, as nothing is shown (HEAD).
    """
    recording = _find_file(tx, user, recording_id)
    if not is_noted:
        audit.record(tx, source, "recording_viewed", recording.robot, recording=recording_id)
    return recording


def download(
    tx: Transaction, source: Source, user: User, recording_id: int, *, is_noted: bool = False
) -> Recording:
    """Let the user have the file of a recording, or a piece; many pieces are one line of the audit log.

    `is_noted`: the audit log has the viewing for which a page wants the piece, or the file is not sent (HEAD). Raises
    RecordMissingError or NotPossibleError.
    """
    recording = _find_file(tx, user, recording_id)
    if not is_noted and recordings.note_download(tx, recording_id, user.id):
        audit.record(tx, source, "recording_downloaded", recording.robot, recording=recording_id)
    return recording


def _find_file(tx: Transaction, user: User, recording_id: int) -> Recording:
    recording = recordings.get(tx, user, "manage", recording_id)
    if recording.started_at is None:
        raise NotPossibleError("cannot send the recording: it has not begun")
    return recording


def _manages(tx: Transaction, user: User, recording_id: int) -> bool:
    newest = recordings.find(tx, user, "manage", before=recording_id + 1, limit=1)
    return any(recording.id == recording_id for recording in newest)

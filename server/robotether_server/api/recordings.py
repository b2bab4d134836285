"""/api/v1/recordings: recordings of robots; asked for and stopped by drivers, downloaded and deleted by managers."""

from typing import Annotated

from flask import Response, request
from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api.auth import Caller
from robotether_server.api.exports import MAX_ID, USUAL_LIMIT, Limit, RobotMac
from robotether_server.api.operations import Created, operation
from robotether_server.db import recordings, seen_robots
from robotether_server.db.recordings import Recording
from robotether_server.identity import normalise_mac
from robotether_server.schemas import Label
from robotether_server.services import recordings as recording_service

FILE_TYPE = "application/octet-stream"
# Where nginx has the files, for answers of web alone.
FILES_PATH = "/recording-files"


class RecordingQuery(Struct, forbid_unknown_fields=True):
    """Which recordings; `before` continues where an earlier answer ended."""

    robot: Label | UnsetType = UNSET
    mac: RobotMac | UnsetType = UNSET
    before: (
        Annotated[int, Meta(ge=1, le=MAX_ID, description="Continue after the one with this id")]
        | UnsetType
    ) = UNSET
    limit: Limit | UnsetType = UNSET


class RecordingList(Struct):
    """Recordings, newest first."""

    recordings: list[Recording]


@operation("POST", "/robots/<robot>/recordings", "user", tag="robots", problems=(403, 404, 409))
def start_recording(caller: Caller, robot: str) -> Created[Recording]:
    """Record a robot, from now until it is stopped.

    Needs level drive. It begins within 2 s if the robot is online, else when the robot is within a minute. It ends
    within 2 s when the caller may no longer drive the robot, and after 4 h.
    """
    return recording_service.ask(caller.tx, caller.user, robot), 201


@operation("GET", "/recordings", "user", tag="robots", problems=(404,))
def list_recordings(caller: Caller, query: RecordingQuery) -> RecordingList:
    """List the recordings of robots that the caller may drive, newest first.

    `robot`: a name that it has now, or had then.
    """
    page = recordings.find(
        caller.tx,
        caller.user,
        "drive",
        robot=query.robot or None,
        mac=None if query.mac is UNSET else normalise_mac(query.mac),
        before=query.before or None,
        limit=query.limit or USUAL_LIMIT,
    )
    if query.robot and not page:
        seen_robots.require(caller.tx, caller.user, query.robot, "observe", "list recordings of")
    return RecordingList(page)


@operation("GET", "/recordings/<int:recording_id>", "user", tag="robots", problems=(404,))
def get_recording(caller: Caller, recording_id: int) -> Recording:
    """Get one recording. Needs level drive on its robot."""
    return recordings.get(caller.tx, caller.user, "drive", recording_id)


@operation("POST", "/recordings/<int:recording_id>/stop", "user", tag="robots", problems=(403, 404))
def stop_recording(caller: Caller, recording_id: int) -> Recording:
    """Stop a recording, within 2 s.

    For the caller who asked for it, and for those who manage the robot. If another one goes on in its place, it stops,
    and answers with, that one. One by the robot's settings begins anew.
    """
    return recording_service.stop(caller.tx, caller.user, recording_id)


@operation("DELETE", "/recordings/<int:recording_id>", "user", tag="robots", problems=(404,))
def delete_recording(caller: Caller, recording_id: int) -> None:
    """Delete a recording and its file. Needs level manage on its robot."""
    recording_service.delete(caller.tx, caller.source, caller.user, recording_id)


@operation(
    "GET",
    "/recordings/<int:recording_id>/file",
    "user",
    tag="robots",
    texts=(FILE_TYPE,),
    statuses=(200, 206),
    problems=(404, 409, 416),
)
def get_recording_file(caller: Caller, recording_id: int) -> Response:
    """Get the file of a recording, MCAP; pieces of it by the header Range.

    Needs level manage on its robot. A recording that goes on is sent as far as it is.
    """
    recording = recording_service.download(
        caller.tx,
        caller.source,
        caller.user,
        recording_id,
        is_noted=request.method == "HEAD",
    )
    return file_response(recording)


def file_response(recording: Recording) -> Response:
    """Return the answer with which nginx sends the file; its name holds numbers and the robot's name alone."""
    response = Response(content_type=FILE_TYPE)
    response.headers["X-Accel-Redirect"] = f"{FILES_PATH}/{recording.id}.mcap"
    name = f"robotether-{recording.robot}-{recording.id}.mcap"
    response.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return response

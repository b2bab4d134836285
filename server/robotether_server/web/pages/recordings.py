"""/recordings: the recordings of robots that a user may drive; those who manage a robot play, download and delete them.

The page that plays one reads its file by pieces. It has a signed word with which the pieces are part of its viewing,
one line of the audit log; what a user may have is decided anew for each piece.
"""

from functools import partial

from flask import Blueprint, Response, current_app, render_template, request
from itsdangerous import BadSignature, URLSafeTimedSerializer

from robotether_server.api.context import context
from robotether_server.api.recordings import file_response
from robotether_server.db import Transaction, recordings, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.recordings import Recording
from robotether_server.db.seen_robots import SeenRobot
from robotether_server.problems import FieldInvalidError
from robotether_server.services import recordings as recording_service
from robotether_server.settings import robot as robot_settings
from robotether_server.web import confirmation, current_user, filters
from robotether_server.web.confirmation import ConfirmedAction, Words

blueprint = Blueprint("recordings", __name__, url_prefix="/recordings")
blueprint.before_request(current_user.require_user)

PAGE = "/recordings"
# Time for which a page reads a file as part of one viewing.
VIEWING_S = 12 * 3600


@blueprint.get("")
def show() -> str:
    """Show the list."""
    user, query = current_user.get(), filters.query_of(("robot",))
    with context().database.transaction() as tx:
        robots = [seen.robot.name for seen in seen_robots.list_seen(tx, user)]
        find = partial(recordings.find, tx, user, limit=filters.ROWS_TO_READ)
        find = partial(find, robot=query["robot"] or None, before=filters.before())
        rows = find("drive")
        managed = {recording.id for recording in find("manage")}
        elsewhere = {cell.name: f"https://{site}" for cell, site in context().other_cells(tx)}
    return render_template(
        "recordings.html",
        page=filters.page(request.path, query, rows),
        query=query,
        robots=filters.name_choices(robots),
        managed=managed,
        elsewhere=elsewhere,
    )


@blueprint.get("/<int:recording_id>")
def play(recording_id: int) -> str:
    """Show the page that plays a recording back."""
    user = current_user.get()
    with context().database.transaction() as tx:
        recording = recording_service.view(
            tx, current_user.source(), user, recording_id, is_noted=request.method == "HEAD"
        )
        topics = _named_topics(seen_robots.find_recorded(tx, user, recording.id))
    viewing = _viewings().dumps([recording_id, user.id])
    return render_template("recording.html", recording=recording, viewing=viewing, topics=topics)


def _named_topics(seen: SeenRobot | None) -> dict[str, str | list[str] | None]:
    """Return the topics that the settings name of what the page shows, by kind; nothing of a robot that is gone."""
    try:
        page = robot_settings.parse(seen.robot.settings).page if seen else None
    except FieldInvalidError:
        page = None
    if page is None:
        return {}
    return {
        "odometry": page.odometry_topic,
        "scan": page.scan_topic,
        "map": page.map_topic,
        "cameras": [camera.topic for camera in page.cameras],
    }


@blueprint.get("/<int:recording_id>/file")
def send_file(recording_id: int) -> Response:
    """Send the file, or a piece of it."""
    user = current_user.get()
    with context().database.transaction() as tx:
        recording = recording_service.download(
            tx,
            current_user.source(),
            user,
            recording_id,
            is_noted=request.method == "HEAD"
            or _is_viewed(request.args.get("viewing", ""), [recording_id, user.id]),
        )
    return file_response(recording)


def _viewings() -> URLSafeTimedSerializer:
    return URLSafeTimedSerializer(current_app.config["SECRET_KEY"], salt="robotether.viewing")


def _is_viewed(viewing: str, members: list[int]) -> bool:
    try:
        return bool(_viewings().loads(viewing, max_age=VIEWING_S) == members)
    except BadSignature:
        return False


def _find(recording_id: int) -> Words:
    with context().database.transaction() as tx:
        recording = recordings.get(tx, current_user.get(), "drive", recording_id)
    return {"recording": recording}


def _stop(tx: Transaction, _source: Source, recording_id: int) -> Recording:
    return recording_service.stop(tx, current_user.get(), recording_id)


def _delete(tx: Transaction, source: Source, recording_id: int) -> Recording:
    return recording_service.delete(tx, source, current_user.get(), recording_id)


confirmation.register(
    blueprint,
    PAGE,
    _find,
    ConfirmedAction(
        path="/<int:recording_id>/stop",
        title="Stop recording {recording.id} of {recording.robot}?",
        effects=("Its file can be downloaded afterwards.",),
        undo="Somebody who may drive the robot can begin another recording.",
        button="Stop recording",
        done="Recording {recording.id} ends within two seconds.",
        do=_stop,
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/<int:recording_id>/delete",
        title="Delete recording {recording.id} of {recording.robot}?",
        effects=("Its file is deleted. If it is still recorded, that ends.",),
        undo="Nobody can undo this.",
        button="Delete recording",
        done="Recording {recording.id} is deleted.",
        do=_delete,
    ),
)

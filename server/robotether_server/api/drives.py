"""/api/v1/drives: who drove which robot, and how; everybody's own, managers' of their robots, admins' all."""

from dataclasses import asdict
from dataclasses import fields as members_of

from flask import Response, jsonify, request

from robotether_server.api import auth, exports, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.api.fields import Fields
from robotether_server.api.objects import plain
from robotether_server.db import drives
from robotether_server.db.drives import Drive, DriveSearch
from robotether_server.db.users import User
from robotether_server.field_types import MAX_NAME_LENGTH

MAX_ID = 2**63 - 1
USUAL_DRIVES = 100
MAX_DRIVES = 500
MAX_FENCE = 2**64 - 1
FILTERS = ("robot", "user", "fence", "since", "until", "before", "limit", "format")
COLUMNS = tuple(member.name for member in members_of(Drive))


@blueprint.get("/drives")
def list_drives() -> Response:
    """List drives, the newest first; `before` goes on where an earlier answer ended."""
    with auth.any_user() as caller:
        given = fields.query(request, FILTERS)
        search = _search(given)
        before = fields.number_in_query(given, "before", 1, MAX_ID)
        limit = fields.number_in_query(given, "limit", 1, MAX_DRIVES)
        if "format" not in given:
            found = drives.find(
                caller.tx, caller.user, search, before=before, limit=limit or USUAL_DRIVES
            )
            return jsonify({"drives": [plain(asdict(one)) for one in found]})
        viewer = caller.user
    kind = fields.choice(given, "format", exports.FORMATS)
    return download(viewer, search, kind, before=before, limit=limit)


@blueprint.get("/drives/<int:drive_id>")
def show_drive(drive_id: int) -> Response:
    """Tell of one drive; browsers that are led here keep it as a file."""
    with auth.any_user() as caller:
        found = drives.get(caller.tx, caller.user, min(drive_id, MAX_ID))
    answer = jsonify(plain(asdict(found)))
    name = f"robotether-drive-{found.id}.json"
    answer.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return answer


def download(
    viewer: User,
    search: DriveSearch,
    kind: exports.Format,
    *,
    before: int | None = None,
    limit: int | None = None,
) -> Response:
    """Stream all drives that fit and that this user may know of."""
    database = context().database

    def fetch(last: int | None, wanted: int) -> list[Drive]:
        start = before if last is None else last
        with database.transaction() as tx:
            return drives.find(tx, viewer, search, before=start, limit=wanted)

    found = (plain(asdict(one)) for one in exports.everything(fetch, limit))
    return exports.answer(found, COLUMNS, kind, "robotether-drives")


def _search(given: Fields) -> DriveSearch:
    return DriveSearch(
        robot=fields.optional_text(given, "robot", MAX_NAME_LENGTH),
        user=fields.optional_text(given, "user", MAX_NAME_LENGTH),
        since=fields.optional_timestamp(given, "since"),
        until=fields.optional_timestamp(given, "until"),
        fence=fields.number_in_query(given, "fence", 0, MAX_FENCE),
    )

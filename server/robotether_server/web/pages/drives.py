"""/drives: who drove which robot, and how; everybody's own, managers' of their robots, admins' all; also as a file."""

from http import HTTPStatus

from flask import Blueprint, Response, render_template

from robotether_server.api.context import context
from robotether_server.api.drives import download
from robotether_server.db import drives
from robotether_server.db.drives import Drive, DriveSearch
from robotether_server.problems import FieldInvalid
from robotether_server.web import current_user, filters
from robotether_server.web.filters import Asked

blueprint = Blueprint("drives", __name__, url_prefix="/drives")
blueprint.before_request(current_user.require_user)

PATH = "/drives"
FILTERS = ("robot", "user", "since", "until")


@blueprint.get("")
def show() -> str | tuple[str, int]:
    """Show one page of drives; `before` is the id of the drive that it ends before."""
    asked = filters.asked(FILTERS)
    try:
        search = _search(asked)
    except FieldInvalid as problem:
        return _page([], asked, problem=problem), HTTPStatus.UNPROCESSABLE_ENTITY
    with context().database.transaction() as tx:
        found = drives.find(
            tx, current_user.get(), search, before=filters.before(), limit=filters.WANTED
        )
    page = filters.page(PATH, asked, found)
    return _page(page.shown, asked, older=page.older, newest=page.newest)


@blueprint.get("/download")
def save() -> Response:
    """Send all matching drives as a file."""
    kind = filters.file_kind()
    return download(current_user.get(), _search(filters.asked(FILTERS)), kind)


def _page(shown: list[Drive], asked: Asked, **more: object) -> str:
    files = filters.files(PATH, asked)
    return render_template("drives.html", drives=shown, asked=asked, files=files, **more)


def _search(asked: Asked) -> DriveSearch:
    return DriveSearch(
        robot=asked["robot"] or None,
        user=asked["user"] or None,
        since=filters.since(asked),
        until=filters.until(asked),
    )

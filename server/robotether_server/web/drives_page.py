"""/drives: who drove which robot, and how; everybody's own, managers' of their robots, admins' all; also as a file."""

from http import HTTPStatus

from flask import Blueprint, Response, render_template

from robotether_server.problems import FieldInvalid
from robotether_server.store import drives
from robotether_server.store.drives import Drive, Search
from robotether_server.web import filters, visitors
from robotether_server.web.api.drives import download
from robotether_server.web.filters import Asked
from robotether_server.web.parts import parts

blueprint = Blueprint("drives", __name__, url_prefix="/drives")
blueprint.before_request(visitors.need_user)

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
    with parts().database.transaction() as tx:
        found = drives.find(
            tx, visitors.visitor(), search, before=filters.before(), limit=filters.WANTED
        )
    page = filters.page(PATH, asked, found)
    return _page(page.shown, asked, older=page.older, newest=page.newest)


@blueprint.get("/download")
def save() -> Response:
    """Give all drives that fit as a file."""
    kind = filters.file_kind()
    return download(visitors.visitor(), _search(filters.asked(FILTERS)), kind)


def _page(shown: list[Drive], asked: Asked, **more: object) -> str:
    files = filters.files(PATH, asked)
    return render_template("drives.html", drives=shown, asked=asked, files=files, **more)


def _search(asked: Asked) -> Search:
    return Search(
        robot=asked["robot"] or None,
        user=asked["user"] or None,
        since=filters.since(asked),
        until=filters.until(asked),
    )

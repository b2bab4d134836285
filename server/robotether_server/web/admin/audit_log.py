"""/admin/audit: who did what, newest first, found by robot, actor, kind and days; and all of it as a file."""

from http import HTTPStatus

from flask import Blueprint, Response, render_template

from robotether_server.api.audit import download
from robotether_server.api.context import context
from robotether_server.db import audit
from robotether_server.db.audit import AuditEvent, AuditSearch
from robotether_server.problems import FieldInvalid
from robotether_server.web import filters
from robotether_server.web.filters import Asked

blueprint = Blueprint("audit_log", __name__, url_prefix="/audit")

PATH = "/admin/audit"
FILTERS = ("robot", "actor", "kind", "since", "until")


@blueprint.get("")
def show() -> str | tuple[str, int]:
    """Show one page of the log; `before` is the id of the event that it ends before."""
    asked = filters.asked(FILTERS)
    try:
        search = _search(asked)
    except FieldInvalid as problem:
        return _page([], asked, problem=problem), HTTPStatus.UNPROCESSABLE_ENTITY
    with context().database.transaction() as tx:
        found = audit.find(tx, search, before=filters.before(), limit=filters.WANTED)
    page = filters.page(PATH, asked, found)
    return _page(page.shown, asked, older=page.older, newest=page.newest)


@blueprint.get("/download")
def save() -> Response:
    """Send all matching events as a file."""
    kind = filters.file_kind()
    return download(_search(filters.asked(FILTERS)), kind)


def _page(events: list[AuditEvent], asked: Asked, **more: object) -> str:
    files = filters.files(PATH, asked)
    return render_template("admin/audit.html", events=events, asked=asked, files=files, **more)


def _search(asked: Asked) -> AuditSearch:
    return AuditSearch(
        robot=asked["robot"] or None,
        actor=asked["actor"] or None,
        kind=asked["kind"] or None,
        since=filters.since(asked),
        until=filters.until(asked),
    )

"""/admin/audit: who did what, newest first, found by robot, actor and kind."""

from urllib.parse import urlencode

from flask import Blueprint, render_template, request

from robotether_server.store import audit
from robotether_server.web.parts import parts

blueprint = Blueprint("audit_log", __name__, url_prefix="/audit")

PER_PAGE = 50
FILTERS = ("robot", "actor", "kind")


@blueprint.get("")
def show() -> str:
    """Show one page of the log; `before` is the id of the event that it ends before."""
    asked = {name: request.args.get(name, "").strip() for name in FILTERS}
    before = request.args.get("before", type=int)
    with parts().database.transaction() as tx:
        # One more than is shown tells whether there is an older page.
        found = audit.find(
            tx,
            robot=asked["robot"] or None,
            actor=asked["actor"] or None,
            kind=asked["kind"] or None,
            before=before,
            limit=PER_PAGE + 1,
        )
    events = found[:PER_PAGE]
    return render_template(
        "admin/audit.html",
        events=events,
        asked=asked,
        newest=_path(asked) if before is not None else None,
        older=_path(asked, before=events[-1].id) if len(found) > PER_PAGE else None,
    )


def _path(asked: dict[str, str], **more: int) -> str:
    query = urlencode({name: value for name, value in asked.items() if value} | more)
    return f"/admin/audit?{query}" if query else "/admin/audit"

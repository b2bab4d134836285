"""/api/v1/audit: what happened; for admins."""

from dataclasses import asdict

from flask import Response, jsonify, request

from robotether_server.administration.names import LONGEST_NAME
from robotether_server.store import audit
from robotether_server.store.audit import AuditEvent, Search
from robotether_server.web import exports, fields
from robotether_server.web.api import callers
from robotether_server.web.api.blueprint import blueprint
from robotether_server.web.api.objects import plain
from robotether_server.web.fields import Fields
from robotether_server.web.parts import parts

LONGEST_KIND = 40
LARGEST_ID = 2**63 - 1
USUAL_EVENTS = 100
MOST_EVENTS = 500
FILTERS = ("robot", "actor", "kind", "since", "until", "before", "limit", "format")
COLUMNS = ("id", "at", "actor", "kind", "robot", "address", "details")


@blueprint.get("/audit")
def list_audit_events() -> Response:
    """List events, the newest first; `before` goes on where an earlier answer ended."""
    with callers.admin() as caller:
        given = fields.query(request, FILTERS)
        search = _search(given)
        before = fields.number_in_query(given, "before", 1, LARGEST_ID)
        limit = fields.number_in_query(given, "limit", 1, MOST_EVENTS)
        if "format" not in given:
            found = audit.find(caller.tx, search, before=before, limit=limit or USUAL_EVENTS)
            return jsonify({"events": [plain(asdict(one)) for one in found]})
    return download(search, fields.choice(given, "format", exports.FORMATS), before, limit)


def download(
    search: Search, kind: exports.Format, before: int | None = None, limit: int | None = None
) -> Response:
    """Stream all events that fit; the caller has seen to it that an admin asks."""
    database = parts().database

    def fetch(last: int | None, wanted: int) -> list[AuditEvent]:
        with database.transaction() as tx:
            return audit.find(tx, search, before=before if last is None else last, limit=wanted)

    found = (plain(asdict(one)) for one in exports.everything(fetch, limit))
    return exports.answer(found, COLUMNS, kind, "robotether-audit")


def _search(given: Fields) -> Search:
    return Search(
        robot=fields.optional_text(given, "robot", LONGEST_NAME),
        actor=fields.optional_text(given, "actor", LONGEST_NAME),
        kind=fields.optional_text(given, "kind", LONGEST_KIND),
        since=fields.optional_moment(given, "since"),
        until=fields.optional_moment(given, "until"),
    )

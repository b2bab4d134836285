"""/api/v1/audit: what happened; for admins."""

from dataclasses import asdict

from flask import Response, jsonify, request

from robotether_server.api import auth, exports, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.api.fields import Fields
from robotether_server.api.objects import plain
from robotether_server.db import audit
from robotether_server.db.audit import AuditEvent, AuditSearch
from robotether_server.field_types import MAX_NAME_LENGTH

MAX_KIND_LENGTH = 40
MAX_ID = 2**63 - 1
USUAL_EVENTS = 100
MAX_EVENTS = 500
FILTERS = ("robot", "actor", "kind", "since", "until", "before", "limit", "format")
COLUMNS = ("id", "at", "actor", "kind", "robot", "address", "details")


@blueprint.get("/audit")
def list_audit_events() -> Response:
    """List events, the newest first; `before` goes on where an earlier answer ended."""
    with auth.admin() as caller:
        given = fields.query(request, FILTERS)
        search = _search(given)
        before = fields.number_in_query(given, "before", 1, MAX_ID)
        limit = fields.number_in_query(given, "limit", 1, MAX_EVENTS)
        if "format" not in given:
            found = audit.find(caller.tx, search, before=before, limit=limit or USUAL_EVENTS)
            return jsonify({"events": [plain(asdict(one)) for one in found]})
    return download(search, fields.choice(given, "format", exports.FORMATS), before, limit)


def download(
    search: AuditSearch, kind: exports.Format, before: int | None = None, limit: int | None = None
) -> Response:
    """Stream all events that fit; the caller has seen to it that an admin asks."""
    database = context().database

    def fetch(last: int | None, wanted: int) -> list[AuditEvent]:
        with database.transaction() as tx:
            return audit.find(tx, search, before=before if last is None else last, limit=wanted)

    found = (plain(asdict(one)) for one in exports.everything(fetch, limit))
    return exports.answer(found, COLUMNS, kind, "robotether-audit")


def _search(given: Fields) -> AuditSearch:
    return AuditSearch(
        robot=fields.optional_text(given, "robot", MAX_NAME_LENGTH),
        actor=fields.optional_text(given, "actor", MAX_NAME_LENGTH),
        kind=fields.optional_text(given, "kind", MAX_KIND_LENGTH),
        since=fields.optional_timestamp(given, "since"),
        until=fields.optional_timestamp(given, "until"),
    )

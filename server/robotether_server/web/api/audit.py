"""/api/v1/audit: what happened; for admins."""

from dataclasses import asdict

from flask import Response, jsonify, request

from robotether_server.store import audit
from robotether_server.web import fields
from robotether_server.web.api import callers
from robotether_server.web.api.blueprint import blueprint
from robotether_server.web.api.objects import plain

LONGEST_NAME = 63
LONGEST_KIND = 40
LARGEST_ID = 2**63 - 1
USUAL_EVENTS = 100
MOST_EVENTS = 500
FILTERS = ("robot", "actor", "kind", "before", "limit")


@blueprint.get("/audit")
def list_audit_events() -> Response:
    """List events, the newest first; `before` goes on where an earlier answer ended."""
    with callers.admin() as caller:
        given = fields.query(request, FILTERS)
        found = audit.find(
            caller.tx,
            robot=fields.optional_text(given, "robot", LONGEST_NAME),
            actor=fields.optional_text(given, "actor", LONGEST_NAME),
            kind=fields.optional_text(given, "kind", LONGEST_KIND),
            before=fields.number_in_query(given, "before", 1, LARGEST_ID),
            limit=fields.number_in_query(given, "limit", 1, MOST_EVENTS) or USUAL_EVENTS,
        )
    return jsonify({"events": [plain(asdict(one)) for one in found]})

"""/admin/audit: who did what, newest first, found by robot, actor, kind and days; and all of it as a file."""

from flask import Blueprint, Response

from robotether_server.api.audit import download
from robotether_server.api.exports import Format
from robotether_server.contract.audit import AuditEvent, event_names
from robotether_server.db import Transaction, audit, seen_robots, users
from robotether_server.db.audit import AuditSearch
from robotether_server.web import filters
from robotether_server.web.filters import FilterChoices, Query

blueprint = Blueprint("audit_log", __name__, url_prefix="/audit")


def _find(tx: Transaction, query: Query) -> list[AuditEvent]:
    return audit.find(tx, _search(query), before=filters.before(), limit=filters.ROWS_TO_READ)


def _send(query: Query, kind: Format) -> Response:
    return download(_search(query), kind)


def _search(query: Query) -> AuditSearch:
    return AuditSearch(
        robot=query["robot"] or None,
        actor=query["actor"] or None,
        kind=query["kind"] or None,
        since=filters.since(query),
        until=filters.until(query),
    )


def _offer(tx: Transaction) -> FilterChoices:
    return {
        "robot": filters.name_choices(seen.robot.name for seen in seen_robots.list_all(tx)),
        "actor": filters.name_choices(user.name for user in users.list_all(tx)),
        "kind": event_names(),
    }


filters.register(
    blueprint,
    "admin/audit.html",
    ("robot", "actor", "kind", "since", "until"),
    _find,
    _send,
    offer=_offer,
)

"""/admin/audit: who did what, newest first, found by robot, actor, kind and days; and all of it as a file."""

from flask import Blueprint, Response

from robotether_server.api.audit import download
from robotether_server.api.exports import Format
from robotether_server.db import Transaction, audit, seen_robots, users
from robotether_server.db.audit import AuditEvent, AuditSearch
from robotether_server.web import filters, page_texts
from robotether_server.web.filters import Asked, Offered

blueprint = Blueprint("audit_log", __name__, url_prefix="/audit")


def _find(tx: Transaction, asked: Asked) -> list[AuditEvent]:
    return audit.find(tx, _search(asked), before=filters.before(), limit=filters.WANTED)


def _send(asked: Asked, kind: Format) -> Response:
    return download(_search(asked), kind)


def _search(asked: Asked) -> AuditSearch:
    return AuditSearch(
        robot=asked["robot"] or None,
        actor=asked["actor"] or None,
        kind=asked["kind"] or None,
        since=filters.since(asked),
        until=filters.until(asked),
    )


def _offer(tx: Transaction) -> Offered:
    return {
        "robot": filters.offered_names(seen.robot.name for seen in seen_robots.list_all(tx)),
        "actor": filters.offered_names(user.name for user in users.list_all(tx)),
        "kind": page_texts.event_names(),
    }


filters.register(
    blueprint,
    "admin/audit.html",
    ("robot", "actor", "kind", "since", "until"),
    _find,
    _send,
    offer=_offer,
)

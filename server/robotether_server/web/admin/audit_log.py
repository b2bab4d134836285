"""/admin/audit: who did what, newest first, found by robot, actor, kind and days; and all of it as a file."""

from collections.abc import Callable
from functools import partial

from flask import Blueprint

from robotether_server.api.audit import download, find_events
from robotether_server.contract.audit import AuditEvent, event_names
from robotether_server.db import Transaction, seen_robots, users
from robotether_server.db.audit import AuditSearch
from robotether_server.web import filters
from robotether_server.web.filters import FilterChoices, Query

blueprint = Blueprint("audit_log", __name__, url_prefix="/audit")


def _finder(query: Query) -> Callable[..., list[AuditEvent]]:
    search = AuditSearch(
        robot=query["robot"] or None,
        actor=query["actor"] or None,
        kind=query["kind"] or None,
        since=filters.since(query),
        until=filters.until(query),
    )
    return partial(find_events, search=search)


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
    _finder,
    download,
    offer=_offer,
)

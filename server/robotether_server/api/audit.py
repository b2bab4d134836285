"""/api/v1/audit: the audit log; for admins. /api/v1/robots/NAME/controller: who held control; for its managers."""

from functools import partial
from typing import Annotated

from flask import Response
from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api import exports
from robotether_server.api.auth import Caller, check_admin
from robotether_server.api.exports import USUAL_LIMIT, ListQuery
from robotether_server.api.operations import operation
from robotether_server.contract.audit import AuditEvent
from robotether_server.contract.control import RobotQuery
from robotether_server.db import Transaction, audit, controllers
from robotether_server.db.audit import AuditSearch
from robotether_server.db.controllers import Controller
from robotether_server.db.users import User
from robotether_server.schemas import GivenTimestamp, Label

COLUMNS = ("id", "at", "actor", "kind", "robot", "address", "details")
download = partial(exports.download, columns=COLUMNS, filename="robotether-audit")


def find_events(
    tx: Transaction, viewer: User, search: AuditSearch, *, before: int | None, limit: int
) -> list[AuditEvent]:
    """Return the events for an admin; raise GrantMissingError for another user."""
    check_admin(viewer)
    return audit.find(tx, search, before=before, limit=limit)


class AuditQuery(ListQuery):
    """Filters of the audit log."""

    actor: Label | UnsetType = UNSET
    kind: Annotated[str, Meta(min_length=1, max_length=40)] | UnsetType = UNSET


class AuditEventList(Struct):
    """Events, newest first; with `format` all that match, as a file."""

    events: list[AuditEvent]


@operation("GET", "/audit", "admin", texts=exports.FILE_TYPES)
def list_audit_events(caller: Caller, query: AuditQuery) -> AuditEventList | Response:
    """List audit events, newest first."""
    search = AuditSearch(
        robot=query.robot or None,
        actor=query.actor or None,
        kind=query.kind or None,
        since=query.since or None,
        until=query.until or None,
    )
    find = partial(find_events, search=search)
    before = query.before or None
    if query.format:
        return download(find, query.format, before=before, limit=query.limit or None)
    return AuditEventList(
        find(caller.tx, caller.user, before=before, limit=query.limit or USUAL_LIMIT)
    )


class ControllerQuery(RobotQuery, frozen=True, kw_only=True):
    """At which time."""

    at: GivenTimestamp


@operation("GET", "/robots/<robot>/controller", "manager", tag="robots")
def show_controller(caller: Caller, robot: str, query: ControllerQuery) -> Controller:
    """Get who held control of a robot at a time, with proof.

    `nobody` and `unknown` are different answers; `reason` says why it is unknown: the time is in the future (`future`),
    too new for all lines to be there (`too_new`), before the log's first line of this robot (`before_log`), in a drive
    whose end nobody recorded (`end_unknown`), between a backup and when it was put back (`restored`), or behind lines
    that a relay could not write (`lines_lost`). The proof has the lines of control as they are, of all others the hash,
    up to the next signed heads (docs/reference/audit-log.md). Times are by the clock of the machine that wrote the
    line.
    """
    return controllers.find(caller.tx, robot, query.at)

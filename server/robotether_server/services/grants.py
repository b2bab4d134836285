"""Grants: which user or group may observe, drive or manage which robot, site or all, and until when."""

import datetime as dt
from typing import Literal, NamedTuple

from robotether_server import times
from robotether_server.db import Transaction, audit, grants, groups, robots, sites, users
from robotether_server.db.audit import Event, Source
from robotether_server.db.grants import Grant, Level, Pair
from robotether_server.problems import RecordMissing


class Grantee(NamedTuple):
    """Who a grant is for."""

    kind: Literal["user", "group"]
    name: str


class Scope(NamedTuple):
    """What a grant is for; the name of `all` is empty."""

    kind: Literal["robot", "site", "all"]
    name: str = ""


ALL = Scope("all")


def give(
    tx: Transaction,
    source: Source,
    grantee: Grantee,
    scope: Scope,
    level: Level,
    *,
    ends_at: dt.datetime | None = None,
) -> tuple[Grant, bool]:
    """Add a grant, which replaces an earlier one of the same pair; tell whether there was none before.

    Raises RecordMissing, or FieldInvalid for an invalid end.
    """
    if ends_at is not None:
        times.check_end("ends_at", ends_at)
    pair = _pair(tx, grantee, scope)
    before = grants.find(tx, pair)
    given = grants.get(tx, grants.put(tx, pair, level, ends_at))
    details = _about(given)
    if before is not None:
        details["was"] = {"level": before.level, "ends_at": _text(before.ends_at)}
    audit.record(tx, source, Event("grant_given", given.robot, details))
    return given, before is None


def revoke_by_id(tx: Transaction, source: Source, grant_id: int) -> Grant:
    """Take a grant away; return it as it was. Raises RecordMissing."""
    found = grants.get(tx, grant_id)
    grants.remove(tx, found.id)
    audit.record(tx, source, Event("grant_taken", found.robot, _about(found)))
    return found


def revoke_from(tx: Transaction, source: Source, grantee: Grantee, scope: Scope) -> Grant:
    """Delete the grant of this pair; raise RecordMissing when there is none."""
    found = grants.find(tx, _pair(tx, grantee, scope))
    if found is None:
        what = "all robots" if scope.kind == "all" else f"{scope.kind} {scope.name}"
        raise RecordMissing(f"cannot revoke: {grantee.kind} {grantee.name} has no grant for {what}")
    return revoke_by_id(tx, source, found.id)


def grant(tx: Transaction, source: Source, user: str, robot: str, level: Level) -> None:
    """Give a user this level for a robot, without an end, replacing an earlier grant; raise RecordMissing."""
    give(tx, source, Grantee("user", user), Scope("robot", robot), level)


def revoke(tx: Transaction, source: Source, user: str, robot: str) -> None:
    """Take a user's own grant for a robot away; raise RecordMissing when there is none."""
    revoke_from(tx, source, Grantee("user", user), Scope("robot", robot))


def list_all(tx: Transaction) -> list[Grant]:
    """Return every grant, ended ones too; admins need none."""
    return grants.list_all(tx)


def _pair(tx: Transaction, grantee: Grantee, scope: Scope) -> Pair:
    is_user = grantee.kind == "user"
    return Pair(
        robot_id=robots.get(tx, scope.name).id if scope.kind == "robot" else None,
        site_id=sites.get(tx, scope.name).id if scope.kind == "site" else None,
        all_robots=scope.kind == "all",
        user_id=users.get(tx, grantee.name).id if is_user else None,
        group_id=None if is_user else groups.get(tx, grantee.name).id,
    )


def _about(given: Grant) -> dict[str, object]:
    """Return a grant's details for the audit log, which has a column of its own for the robot."""
    known = {"user": given.user, "group": given.group, "site": given.site}
    about: dict[str, object] = {name: value for name, value in known.items() if value is not None}
    if given.is_for_all:
        about["all"] = True
    about["level"] = given.level
    if given.ends_at is not None:
        about["ends_at"] = _text(given.ends_at)
    return about


def _text(timestamp: dt.datetime | None) -> str | None:
    return timestamp.isoformat(timespec="seconds") if timestamp else None

"""Grants: which user or group may observe, drive or manage which robot, site or all, and until when.

Admins add, fill and remove groups of users and sites of robots.
"""

import datetime as dt
from typing import Literal, NamedTuple

from robotether_server import schemas, times
from robotether_server.db import Transaction, audit, grants, robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, SITES, Collection, Grant, Group, Pair, R
from robotether_server.db.robots import RobotRow
from robotether_server.problems import NotPossibleError, RecordMissingError
from robotether_server.schemas import Level, NewPlainName


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
    """Add a grant, which replaces an earlier one of the same pair; return whether there was none before.

    Raises RecordMissingError, or FieldInvalidError for an invalid end.
    """
    if ends_at is not None:
        times.check_end(ends_at, tx.now())
    pair = _pair(tx, grantee, scope)
    before = grants.find(tx, pair)
    grant = grants.get(tx, grants.put(tx, pair, level, ends_at))
    details = _about(grant)
    if before is not None:
        details["was"] = {"level": before.level, "ends_at": _text(before.ends_at)}
    audit.record(tx, source, "grant_given", grant.robot, **details)
    return grant, before is None


def is_given(tx: Transaction, grantee: Grantee, scope: Scope) -> bool:
    """Return whether there is a grant of this pair, ended or not; raise RecordMissingError."""
    return grants.find(tx, _pair(tx, grantee, scope)) is not None


def revoke_by_id(tx: Transaction, source: Source, grant_id: int) -> Grant:
    """Take a grant away; return it as it was. Raises RecordMissingError."""
    grant = grants.get(tx, grant_id)
    grants.remove(tx, grant.id)
    audit.record(tx, source, "grant_taken", grant.robot, **_about(grant))
    return grant


def revoke_from(tx: Transaction, source: Source, grantee: Grantee, scope: Scope) -> Grant:
    """Delete the grant of this pair; raise RecordMissingError when there is none."""
    grant = grants.find(tx, _pair(tx, grantee, scope))
    if grant is None:
        what = "all robots" if scope.kind == "all" else f"{scope.kind} {scope.name}"
        raise RecordMissingError(
            f"cannot revoke: {grantee.kind} {grantee.name} has no grant for {what}"
        )
    return revoke_by_id(tx, source, grant.id)


def _pair(tx: Transaction, grantee: Grantee, scope: Scope) -> Pair:
    is_user = grantee.kind == "user"
    return Pair(
        robot_id=robots.get(tx, scope.name).id if scope.kind == "robot" else None,
        site_id=SITES.get(tx, scope.name).id if scope.kind == "site" else None,
        all_robots=scope.kind == "all",
        user_id=users.get(tx, grantee.name).id if is_user else None,
        group_id=None if is_user else GROUPS.get(tx, grantee.name).id,
    )


def _about(grant: Grant) -> dict[str, object]:
    """Return a grant's details for the audit log, which has a column of its own for the robot."""
    names = {"user": grant.user, "group": grant.group, "site": grant.site}
    about: dict[str, object] = {name: value for name, value in names.items() if value is not None}
    if grant.all:
        about["all"] = True
    about["level"] = grant.level
    if grant.ends_at is not None:
        about["ends_at"] = _text(grant.ends_at)
    return about


def _text(timestamp: dt.datetime | None) -> str | None:
    return timestamp.isoformat(timespec="seconds") if timestamp else None


def add_collection(tx: Transaction, source: Source, collection: Collection[R], name: str) -> R:
    """Add a group or a site without members; raise FieldInvalidError or RecordExistsError."""
    schemas.check("name", name, NewPlainName)
    collection.add(tx, name)
    audit.record(tx, source, f"{collection.kind}_added", **{collection.kind: name})
    return collection.get(tx, name)


def remove_collection(tx: Transaction, source: Source, collection: Collection[R], name: str) -> R:
    """Remove a group or a site with its grants; return it as it was. Raises RecordMissingError."""
    record = collection.get(tx, name)
    collection.remove(tx, record.id)
    details = {collection.kind: name, collection.members: list(record.members)}
    audit.record(tx, source, f"{collection.kind}_removed", **details)
    return record


def add_member(tx: Transaction, source: Source, name: str, user: str) -> Group:
    """Give a user the grants of a group; raise RecordMissingError. Members stay members."""
    if grants.add_member(tx, GROUPS.get(tx, name).id, users.get(tx, user).id):
        audit.record(tx, source, "group_member_added", group=name, user=user)
    return GROUPS.get(tx, name)


def remove_member(tx: Transaction, source: Source, name: str, user: str) -> Group:
    """Remove a user from a group; raise RecordMissingError."""
    if not grants.remove_member(tx, GROUPS.get(tx, name).id, users.get(tx, user).id):
        raise RecordMissingError(
            f"cannot remove user {user} from group {name}: the user is not a member"
        )
    audit.record(tx, source, "group_member_removed", group=name, user=user)
    return GROUPS.get(tx, name)


def place_robot(tx: Transaction, source: Source, robot: str, site: str | None) -> RobotRow:
    """Put a robot at a site, or at none; raise RecordMissingError."""
    row = robots.get(tx, robot)
    if row.site != site:
        grants.place_robot(tx, row.id, None if site is None else SITES.get(tx, site).id)
        audit.record(tx, source, "robot_site_set", robot, was=row.site, site=site)
    return robots.get(tx, robot)


def remove_robot(tx: Transaction, source: Source, name: str, robot: str) -> RobotRow:
    """Remove a robot from a site; raise RecordMissingError, or NotPossibleError when it is not there."""
    if robots.get(tx, robot).site != name:
        raise NotPossibleError(f"cannot remove robot {robot} from site {name}: it is not there")
    return place_robot(tx, source, robot, None)

"""/api/v1/grants: who may use which robots, at which level, until when; for admins, who need no grant."""

from typing import Annotated, Literal, TypeVar

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api.auth import Caller
from robotether_server.api.operations import operation
from robotether_server.db.grants import Grant, Level
from robotether_server.field_types import (
    GivenTimestamp,
    PlainName,
    RobotName,
    Timestamp,
    UserName,
)
from robotether_server.problems import FieldInvalid
from robotether_server.services import grants as grant_service
from robotether_server.services.grants import ALL, Grantee, Scope

T = TypeVar("T")
End = Annotated[
    GivenTimestamp,
    Meta(description="When it ends by itself, within ten years; null or missing: never"),
]
EXACTLY_ONE_OF_EACH = Meta(
    extra_json_schema={
        "allOf": [
            {"oneOf": [{"required": [kind]} for kind in kinds]}
            for kinds in (("user", "group"), ("robot", "site", "all"))
        ]
    }
)


class GivenLevel(Struct, forbid_unknown_fields=True):
    """The level of a user for a robot."""

    level: Level
    ends_at: End | UnsetType | None = UNSET


class NewGrant(GivenLevel):
    """A grant: exactly one of user and group, and exactly one of robot, site and all."""

    user: UserName | UnsetType = UNSET
    group: PlainName | UnsetType = UNSET
    robot: RobotName | UnsetType = UNSET
    site: PlainName | UnsetType = UNSET
    all: Annotated[Literal[True], Meta(extra={"must": "true, or left out"})] | UnsetType = UNSET


class ShownGrant(Struct):
    """A grant: either user or group is null; either robot or site is null, both for all robots."""

    id: int
    user: str | None
    group: str | None
    robot: str | None
    site: str | None
    all: bool
    level: Level
    ends_at: Timestamp | None


class GrantList(Struct):
    """Grants, ended ones included. Of several for one robot, the highest level counts."""

    grants: list[ShownGrant]


@operation("GET", "/grants", "admin")
def list_grants(caller: Caller) -> GrantList:
    """List grants; admins need none."""
    return GrantList([_shown(one) for one in grant_service.list_all(caller.tx)])


@operation("POST", "/grants", "admin", problems=(404,))
def add_grant(
    caller: Caller, body: Annotated[NewGrant, EXACTLY_ONE_OF_EACH]
) -> tuple[ShownGrant, Literal[200, 201]]:
    """Add a grant; it replaces an earlier one with the same subject and object.

    200: it replaced another.
    """
    given, is_new = _give(caller, _grantee(body), _scope(body), body)
    return given, 201 if is_new else 200


@operation("DELETE", "/grants/<int:grant_id>", "admin")
def delete_grant(caller: Caller, grant_id: int) -> None:
    """Delete a grant."""
    grant_service.revoke_by_id(caller.tx, caller.source, grant_id)


@operation("PUT", "/grants/<user>/<robot>", "admin")
def give_grant(caller: Caller, user: str, robot: str, body: GivenLevel) -> ShownGrant:
    """Set the user's level for the robot."""
    given, _ = _give(caller, Grantee("user", user), Scope("robot", robot), body)
    return given


@operation("DELETE", "/grants/<user>/<robot>", "admin", name="takeGrant", problems=(409,))
def revoke_grant(caller: Caller, user: str, robot: str) -> None:
    """Delete the user's grant for the robot."""
    grant_service.revoke(caller.tx, caller.source, user, robot)


def _give(
    caller: Caller, grantee: Grantee, scope: Scope, body: GivenLevel
) -> tuple[ShownGrant, bool]:
    given, is_new = grant_service.give(
        caller.tx, caller.source, grantee, scope, body.level, ends_at=body.ends_at or None
    )
    return _shown(given), is_new


def _grantee(body: NewGrant) -> Grantee:
    grantee_kinds: tuple[Literal["user", "group"], ...] = ("user", "group")
    given = [
        Grantee(kind, name) for kind in grantee_kinds if (name := getattr(body, kind)) is not UNSET
    ]
    return _the_one(given, "user, group")


def _scope(body: NewGrant) -> Scope:
    scopes: tuple[Literal["robot", "site"], ...] = ("robot", "site")
    given = [Scope(kind, name) for kind in scopes if (name := getattr(body, kind)) is not UNSET]
    return _the_one([*given, *([ALL] if body.all else [])], "robot, site, all")


def _the_one(given: list[T], kinds: str) -> T:
    if len(given) != 1:
        raise FieldInvalid(f"cannot give a grant: give exactly one of {kinds}")
    return given[0]


def _shown(grant: Grant) -> ShownGrant:
    return ShownGrant(
        id=grant.id,
        user=grant.user,
        group=grant.group,
        robot=grant.robot,
        site=grant.site,
        all=grant.is_for_all,
        level=grant.level,
        ends_at=grant.ends_at,
    )

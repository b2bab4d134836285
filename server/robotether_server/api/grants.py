"""/api/v1/grants: who may use which robots, at which level, until when; for admins, who need no grant.

/api/v1/groups: groups of users; members have the grants of the group. /api/v1/sites: sites of robots; a grant can be
for all robots of a site. A robot is put at a site by PATCH /api/v1/robots/NAME.
"""

from typing import Annotated, Literal, TypeVar

from msgspec import UNSET, Meta, Struct, UnsetType, convert

from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import grants, seen_robots
from robotether_server.db.grants import GROUPS, SITES, Grant, Group, Site
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import (
    GivenTimestamp,
    Level,
    Mac,
    NewPlainName,
    PlainName,
    RobotName,
    Timestamp,
    UserName,
)
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
        ],
        "dependentRequired": {"mac": ["robot"]},
    }
)


class GivenLevel(Struct, forbid_unknown_fields=True):
    """The level of a user for a robot."""

    level: Level
    ends_at: End | UnsetType | None = UNSET


class NewGrant(GivenLevel):
    """A grant: exactly one of user and group, and exactly one of robot, site and all.

    `mac`: that of the robot meant, as another one may have its name by now.
    """

    user: UserName | UnsetType = UNSET
    group: PlainName | UnsetType = UNSET
    robot: RobotName | UnsetType = UNSET
    mac: Mac | UnsetType = UNSET
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


class NewGroup(Struct, forbid_unknown_fields=True):
    """A new group."""

    name: NewPlainName


class GroupList(Struct):
    """Groups, by name."""

    groups: list[Group]


class NewSite(Struct, forbid_unknown_fields=True):
    """A new site."""

    name: NewPlainName


class SiteList(Struct):
    """Sites, by name."""

    sites: list[Site]


@operation("GET", "/grants", "admin")
def list_grants(caller: Caller) -> GrantList:
    """List grants; admins need none."""
    return GrantList([_describe(grant) for grant in grants.list_all(caller.tx)])


@operation("POST", "/grants", "admin", problems=(404,))
def add_grant(
    caller: Caller, body: Annotated[NewGrant, EXACTLY_ONE_OF_EACH]
) -> tuple[ShownGrant, Literal[200, 201]]:
    """Add a grant; it replaces an earlier one with the same subject and object.

    200: it replaced another.
    """
    grantee, scope = _grantee(body), _scope(body)
    if body.mac is not UNSET:
        if scope.kind != "robot":
            raise FieldInvalidError("cannot give a grant: mac is that of a robot", "mac")
        to = "give a grant for"
        seen_robots.require(caller.tx, caller.user, scope.name, "manage", to, mac=body.mac)
    grant, is_new = _give(caller, grantee, scope, body)
    return grant, 201 if is_new else 200


@operation("DELETE", "/grants/<int:grant_id>", "admin")
def delete_grant(caller: Caller, grant_id: int) -> None:
    """Delete a grant."""
    grant_service.revoke_by_id(caller.tx, caller.source, grant_id)


@operation("PUT", "/grants/<user>/<robot>", "admin")
def give_grant(caller: Caller, user: str, robot: str, body: GivenLevel) -> ShownGrant:
    """Set the user's level for the robot."""
    grant, _ = _give(caller, Grantee("user", user), Scope("robot", robot), body)
    return grant


@operation("DELETE", "/grants/<user>/<robot>", "admin", name="takeGrant")
def revoke_grant(caller: Caller, user: str, robot: str) -> None:
    """Delete the user's grant for the robot."""
    grant_service.revoke_from(
        caller.tx, caller.source, Grantee("user", user), Scope("robot", robot)
    )


def _give(
    caller: Caller, grantee: Grantee, scope: Scope, body: GivenLevel
) -> tuple[ShownGrant, bool]:
    grant, is_new = grant_service.give(
        caller.tx, caller.source, grantee, scope, body.level, ends_at=body.ends_at or None
    )
    return _describe(grant), is_new


def _grantee(body: NewGrant) -> Grantee:
    grantee_kinds: tuple[Literal["user", "group"], ...] = ("user", "group")
    choices = [
        Grantee(kind, name) for kind in grantee_kinds if (name := getattr(body, kind)) is not UNSET
    ]
    return _the_one(choices, "user, group")


def _scope(body: NewGrant) -> Scope:
    scopes: tuple[Literal["robot", "site"], ...] = ("robot", "site")
    choices = [Scope(kind, name) for kind in scopes if (name := getattr(body, kind)) is not UNSET]
    return _the_one([*choices, *([ALL] if body.all else [])], "robot, site, all")


def _the_one(choices: list[T], kinds: str) -> T:
    if len(choices) != 1:
        raise FieldInvalidError(f"cannot give a grant: give exactly one of {kinds}")
    return choices[0]


def _describe(grant: Grant) -> ShownGrant:
    return convert(grant, ShownGrant, from_attributes=True)


@operation("GET", "/groups", "admin")
def list_groups(caller: Caller) -> GroupList:
    """List groups; members have the grants of the group."""
    return GroupList(GROUPS.list_all(caller.tx))


@operation("POST", "/groups", "admin", problems=(409,))
def add_group(caller: Caller, body: NewGroup) -> Created[Group]:
    """Add a group."""
    return grant_service.add_collection(caller.tx, caller.source, GROUPS, body.name), 201


@operation("GET", "/groups/<group>", "admin")
def show_group(caller: Caller, group: str) -> Group:
    """Get a group."""
    return GROUPS.get(caller.tx, group)


@operation("DELETE", "/groups/<group>", "admin")
def remove_group(caller: Caller, group: str) -> None:
    """Remove the group with its grants; its members stay users."""
    grant_service.remove_collection(caller.tx, caller.source, GROUPS, group)


@operation("PUT", "/groups/<group>/members/<user>", "admin")
def add_member(caller: Caller, group: str, user: str) -> Group:
    """Add the user to the group."""
    return grant_service.add_member(caller.tx, caller.source, group, user)


@operation("DELETE", "/groups/<group>/members/<user>", "admin")
def remove_member(caller: Caller, group: str, user: str) -> None:
    """Remove the user from the group."""
    grant_service.remove_member(caller.tx, caller.source, group, user)


@operation("GET", "/sites", "admin")
def list_sites(caller: Caller) -> SiteList:
    """List sites of robots."""
    return SiteList(SITES.list_all(caller.tx))


@operation("POST", "/sites", "admin", problems=(409,))
def add_site(caller: Caller, body: NewSite) -> Created[Site]:
    """Add a site."""
    return grant_service.add_collection(caller.tx, caller.source, SITES, body.name), 201


@operation("GET", "/sites/<site>", "admin")
def show_site(caller: Caller, site: str) -> Site:
    """Get a site."""
    return SITES.get(caller.tx, site)


@operation("DELETE", "/sites/<site>", "admin")
def remove_site(caller: Caller, site: str) -> None:
    """Remove the site with its grants; its robots stay, without a site."""
    grant_service.remove_collection(caller.tx, caller.source, SITES, site)

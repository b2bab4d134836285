"""/api/v1/groups: groups of users, whose grants every member has; for admins."""

from msgspec import Struct

from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import grants
from robotether_server.db.grants import Group
from robotether_server.field_types import NewPlainName
from robotether_server.services import grants as grant_service


class NewGroup(Struct, forbid_unknown_fields=True):
    """A group to be added."""

    name: NewPlainName


class GroupList(Struct):
    """Groups, by name."""

    groups: list[Group]


@operation("GET", "/groups", "admin")
def list_groups(caller: Caller) -> GroupList:
    """Groups of users, whose grants every member has."""
    return GroupList(grants.list_groups(caller.tx))


@operation("POST", "/groups", "admin", problems=(409,))
def add_group(caller: Caller, body: NewGroup) -> Created[Group]:
    """Add a group."""
    return grant_service.add_group(caller.tx, caller.source, body.name), 201


@operation("GET", "/groups/<group>", "admin")
def show_group(caller: Caller, group: str) -> Group:
    """One group."""
    return grants.get_group(caller.tx, group)


@operation("DELETE", "/groups/<group>", "admin")
def remove_group(caller: Caller, group: str) -> None:
    """Remove the group with its grants; its members stay users."""
    grant_service.remove_group(caller.tx, caller.source, group)


@operation("PUT", "/groups/<group>/members/<user>", "admin")
def add_member(caller: Caller, group: str, user: str) -> Group:
    """Make the user a member."""
    return grant_service.add_member(caller.tx, caller.source, group, user)


@operation("DELETE", "/groups/<group>/members/<user>", "admin")
def remove_member(caller: Caller, group: str, user: str) -> None:
    """End the membership."""
    grant_service.remove_member(caller.tx, caller.source, group, user)

"""/api/v1/groups: groups of users; members have the grants of the group; for admins."""

from msgspec import Struct

from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import groups
from robotether_server.db.groups import Group
from robotether_server.field_types import NewPlainName
from robotether_server.services import groups as group_service


class NewGroup(Struct, forbid_unknown_fields=True):
    """A new group."""

    name: NewPlainName


class GroupList(Struct):
    """Groups, by name."""

    groups: list[Group]


@operation("GET", "/groups", "admin")
def list_groups(caller: Caller) -> GroupList:
    """List groups; members have the grants of the group."""
    return GroupList(groups.list_all(caller.tx))


@operation("POST", "/groups", "admin", problems=(409,))
def add_group(caller: Caller, body: NewGroup) -> Created[Group]:
    """Add a group."""
    return group_service.add(caller.tx, caller.source, body.name), 201


@operation("GET", "/groups/<group>", "admin")
def show_group(caller: Caller, group: str) -> Group:
    """Get a group."""
    return groups.get(caller.tx, group)


@operation("DELETE", "/groups/<group>", "admin")
def remove_group(caller: Caller, group: str) -> None:
    """Remove the group with its grants; its members stay users."""
    group_service.remove(caller.tx, caller.source, group)


@operation("PUT", "/groups/<group>/members/<user>", "admin")
def add_member(caller: Caller, group: str, user: str) -> Group:
    """Add the user to the group."""
    return group_service.add_member(caller.tx, caller.source, group, user)


@operation("DELETE", "/groups/<group>/members/<user>", "admin")
def remove_member(caller: Caller, group: str, user: str) -> None:
    """Remove the user from the group."""
    group_service.remove_member(caller.tx, caller.source, group, user)

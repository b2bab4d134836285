"""/api/v1/groups: groups of users, whose grants every member has; for admins."""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.db import groups
from robotether_server.db.groups import Group
from robotether_server.services import groups as group_service
from robotether_server.services.names import MAX_NAME_LENGTH


@blueprint.get("/groups")
def list_groups() -> Response:
    """List the groups with their members."""
    with auth.admin() as caller:
        found = groups.list_all(caller.tx)
    return jsonify({"groups": [_object(one) for one in found]})


@blueprint.post("/groups")
def add_group() -> tuple[Response, int]:
    """Add a group without members."""
    with auth.admin() as caller:
        name = fields.text(fields.json_object(request, ("name",)), "name", MAX_NAME_LENGTH)
        added = group_service.add(caller.tx, caller.source, name)
    return jsonify(_object(added)), HTTPStatus.CREATED


@blueprint.get("/groups/<group>")
def show_group(group: str) -> Response:
    """Show one group."""
    with auth.admin() as caller:
        found = groups.get(caller.tx, group)
    return jsonify(_object(found))


@blueprint.delete("/groups/<group>")
def remove_group(group: str) -> tuple[str, int]:
    """Remove the group with its grants; its members stay users."""
    with auth.admin() as caller:
        group_service.remove(caller.tx, caller.source, group)
    return "", HTTPStatus.NO_CONTENT


@blueprint.put("/groups/<group>/members/<user>")
def add_member(group: str, user: str) -> Response:
    """Make the user a member."""
    with auth.admin() as caller:
        changed = group_service.add_member(caller.tx, caller.source, group, user)
    return jsonify(_object(changed))


@blueprint.delete("/groups/<group>/members/<user>")
def remove_member(group: str, user: str) -> tuple[str, int]:
    """End the membership."""
    with auth.admin() as caller:
        group_service.remove_member(caller.tx, caller.source, group, user)
    return "", HTTPStatus.NO_CONTENT


def _object(group: Group) -> dict[str, object]:
    return {"id": group.id, "name": group.name, "members": list(group.members)}

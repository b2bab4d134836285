"""/api/v1/grants: who may do what with which robots, and until when; for admins, who need no grant themselves."""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.auth import Caller
from robotether_server.api.blueprint import blueprint
from robotether_server.api.fields import Fields
from robotether_server.api.objects import grant_object
from robotether_server.db.grants import LEVELS, Grant
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.problems import FieldInvalid
from robotether_server.services import grants as grant_service
from robotether_server.services.grants import ALL, Grantee, Scope

REQUEST = ("user", "group", "robot", "site", "all", "level", "ends_at")


@blueprint.get("/grants")
def list_grants() -> Response:
    """List the grants, ended ones too."""
    with auth.admin() as caller:
        found = grant_service.list_all(caller.tx)
    return jsonify({"grants": [grant_object(one) for one in found]})


@blueprint.post("/grants")
def add_grant() -> tuple[Response, int]:
    """Give a grant, in place of an earlier one of the same two."""
    with auth.admin() as caller:
        body = fields.json_object(request, REQUEST)
        given, is_new = _give(caller, _grantee(body), _scope(body), body)
    return jsonify(grant_object(given)), HTTPStatus.CREATED if is_new else HTTPStatus.OK


@blueprint.delete("/grants/<int:grant_id>")
def delete_grant(grant_id: int) -> tuple[str, int]:
    """Take one grant away."""
    with auth.admin() as caller:
        grant_service.revoke_by_id(caller.tx, caller.source, grant_id)
    return "", HTTPStatus.NO_CONTENT


@blueprint.put("/grants/<user>/<robot>")
def give_grant(user: str, robot: str) -> Response:
    """Let the user do this with the robot, in place of an earlier grant."""
    with auth.admin() as caller:
        body = fields.json_object(request, ("level", "ends_at"))
        given, _ = _give(caller, Grantee("user", user), Scope("robot", robot), body)
    return jsonify(grant_object(given))


@blueprint.delete("/grants/<user>/<robot>")
def revoke_grant(user: str, robot: str) -> tuple[str, int]:
    """Take the grant away."""
    with auth.admin() as caller:
        grant_service.revoke(caller.tx, caller.source, user, robot)
    return "", HTTPStatus.NO_CONTENT


def _give(caller: Caller, grantee: Grantee, scope: Scope, body: Fields) -> tuple[Grant, bool]:
    level = fields.choice(body, "level", LEVELS)
    ends_at = fields.optional_timestamp(body, "ends_at")
    return grant_service.give(caller.tx, caller.source, grantee, scope, level, ends_at=ends_at)


def _grantee(body: Fields) -> Grantee:
    kind = _the_one(body, ("user", "group"))
    name = fields.text(body, kind, MAX_NAME_LENGTH)
    return Grantee("user", name) if kind == "user" else Grantee("group", name)


def _scope(body: Fields) -> Scope:
    kind = _the_one(body, ("robot", "site", "all"))
    if kind == "all":
        if body["all"] is not True:
            raise FieldInvalid("cannot use all: it must be true, or left out")
        return ALL
    name = fields.text(body, kind, MAX_NAME_LENGTH)
    return Scope("robot", name) if kind == "robot" else Scope("site", name)


def _the_one(body: Fields, kinds: tuple[str, ...]) -> str:
    given = [kind for kind in kinds if kind in body]
    if len(given) != 1:
        raise FieldInvalid(f"cannot give a grant: give exactly one of {', '.join(kinds)}")
    return given[0]

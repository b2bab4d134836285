"""/api/v1/grants: who may do what with which robot; for admins, who need no grant themselves."""

from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.administration import grants as deeds
from robotether_server.store.grants import LEVELS
from robotether_server.web import fields
from robotether_server.web.api import callers
from robotether_server.web.api.blueprint import blueprint


@blueprint.get("/grants")
def list_grants() -> Response:
    """List the grants, by user and robot."""
    with callers.admin() as caller:
        found = deeds.list_all(caller.tx)
    return jsonify({"grants": [asdict(one) for one in found]})


@blueprint.put("/grants/<user>/<robot>")
def give_grant(user: str, robot: str) -> Response:
    """Let the user do this with the robot, in place of an earlier grant."""
    with callers.admin() as caller:
        level = fields.choice(fields.json_object(request, ("level",)), "level", LEVELS)
        deeds.grant(caller.tx, caller.source, user, robot, level)
    return jsonify({"user": user, "robot": robot, "level": level})


@blueprint.delete("/grants/<user>/<robot>")
def take_grant(user: str, robot: str) -> tuple[str, int]:
    """Take the grant away."""
    with callers.admin() as caller:
        deeds.revoke(caller.tx, caller.source, user, robot)
    return "", HTTPStatus.NO_CONTENT

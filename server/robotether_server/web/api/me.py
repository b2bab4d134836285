"""/api/v1/me: who asks."""

from flask import Response, jsonify, request

from robotether_server.web import access
from robotether_server.web.api.blueprint import blueprint
from robotether_server.web.parts import parts


@blueprint.get("/me")
def me() -> Response:
    """Tell who asks."""
    with parts().database.transaction() as tx:
        user = access.api_user(tx, request)
    return jsonify({"name": user.name, "role": user.role})

"""/api/v1/me: who asks."""

from flask import Response, jsonify

from robotether_server.api import callers
from robotether_server.api.blueprint import blueprint


@blueprint.get("/me")
def me() -> Response:
    """Tell who asks."""
    with callers.any_user() as caller:
        return jsonify({"name": caller.user.name, "role": caller.user.role})

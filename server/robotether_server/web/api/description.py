"""Tells what the API offers: GET /api/v1/openapi.json, OpenAPI 3.1."""

from flask import Response, current_app

from robotether_server.web.api.blueprint import blueprint


@blueprint.get("/openapi.json")
def openapi() -> Response:
    """Describe this API."""
    with current_app.open_resource("api/openapi.json", "rb") as file:
        return Response(file.read(), content_type="application/json")

"""/api/v1/robots/NAME/page and /buttons: what a robot's managers set of its drive page."""

from flask import Response, jsonify, request

from robotether_server.api import callers, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.page_settings import NAMES
from robotether_server.services import drive_pages, permissions


@blueprint.put("/robots/<robot>/page")
def set_page(robot: str) -> Response:
    """Replace the page's settings; what is missing is as by default."""
    with callers.any_user() as caller:
        permissions.find_managed(caller.tx, caller.user, robot)
        body = fields.json_object(request, NAMES)
        settings = drive_pages.set_page(caller.tx, caller.source, robot, body)
    return jsonify(settings.page.as_dict())


@blueprint.put("/robots/<robot>/buttons")
def set_buttons(robot: str) -> Response:
    """Replace the buttons."""
    with callers.any_user() as caller:
        permissions.find_managed(caller.tx, caller.user, robot)
        body = fields.json_object(request, ("buttons",))
        settings = drive_pages.set_buttons(caller.tx, caller.source, robot, body.get("buttons"))
    return jsonify({"buttons": [button.as_dict() for button in settings.buttons]})

"""/robots/NAME/settings: what a manager sets of a robot's drive page, in a form; and its buttons.

For whoever manages the robot, admins included. docs/protocols.md describes `page` and `buttons`.
"""

from flask import Blueprint

from robotether_server.web import current_user
from robotether_server.web.pages import button_forms, drive_page_form

blueprint = Blueprint("drive_settings", __name__, url_prefix="/robots/<name>/settings")
blueprint.before_request(current_user.require_user)
for part in (drive_page_form, button_forms):
    blueprint.register_blueprint(part.blueprint)

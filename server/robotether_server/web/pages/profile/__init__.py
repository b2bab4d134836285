"""/profile: what everybody keeps of their own. Password, SSH keys, API tokens, the SSH configuration, logins."""

from flask import Blueprint

from robotether_server.web import current_user
from robotether_server.web.pages.profile import api_tokens, overview, password, user_keys

blueprint = Blueprint("profile", __name__, url_prefix="/profile")
blueprint.before_request(current_user.require_user)
for part in (overview, password, user_keys, api_tokens):
    blueprint.register_blueprint(part.blueprint)

"""The admin pages under /admin: robots and how they are added, people and rights, tokens, audit log, backups, health.

Plain forms over robotether_server.services, which checks, changes and writes the audit log. Every path that
takes a POST also answers a GET, so that a log-in after an expired login leads back to it.
"""

from flask import Blueprint, redirect
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.web import current_user
from robotether_server.web.admin import (
    add_robot,
    audit_log,
    grants,
    groups_and_sites,
    health,
    pending,
    robots,
    selected_robots,
    selected_users,
    tokens,
    users,
)

blueprint = Blueprint("admin", __name__, url_prefix="/admin")
blueprint.before_request(current_user.require_admin)
for part in (
    robots,
    selected_robots,
    add_robot,
    pending,
    users,
    selected_users,
    groups_and_sites,
    grants,
    tokens,
    audit_log,
    health,
):
    blueprint.register_blueprint(part.blueprint)


@blueprint.get("/")
def start() -> AnyResponse:
    """Begin with the robots."""
    return redirect("/admin/robots")

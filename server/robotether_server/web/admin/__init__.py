"""The admin pages under /admin: robots, who waits, users and grants, tokens, the audit log.

Plain forms over robotether_server.administration, which checks, changes and writes the audit log. Every path that
takes a POST also answers a GET, so that a login that ended in between leads back to where it was.
"""

from flask import Blueprint, redirect
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.web import visitors
from robotether_server.web.admin import (
    audit_log,
    grants,
    join_tokens,
    pending,
    robot_changes,
    robot_deeds,
    robot_list,
    robot_page,
    tokens,
    user_deeds,
    users,
)

blueprint = Blueprint("admin", __name__, url_prefix="/admin")
blueprint.before_request(visitors.need_admin)
for part in (
    robot_list,
    robot_page,
    robot_deeds,
    robot_changes,
    pending,
    users,
    user_deeds,
    grants,
    join_tokens,
    tokens,
    audit_log,
):
    blueprint.register_blueprint(part.blueprint)


@blueprint.get("/")
def start() -> AnyResponse:
    """Begin with the robots."""
    return redirect("/admin/robots")

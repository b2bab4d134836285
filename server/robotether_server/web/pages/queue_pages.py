"""/queue and /queue/supervise: who helps which robot next, for operators and for those who manage robots.

Their scripts fill them by the API of requests (api/requests.py), which decides by each user's rights.
"""

from flask import Blueprint, render_template

from robotether_server.problems import GrantMissingError
from robotether_server.web import current_user

blueprint = Blueprint("queue_pages", __name__, url_prefix="/queue")
blueprint.before_request(current_user.require_user)


@blueprint.get("")
def show_queue() -> str:
    """Show what is offered to the user, what the user works on, and what waits."""
    return render_template("queue.html", may_drive=bool(current_user.levels() - {"observe"}))


@blueprint.get("/supervise")
def supervise() -> str:
    """Show all requests and operators of the robots that the user manages; raise GrantMissingError."""
    if "manage" not in current_user.levels():
        raise GrantMissingError("This page is for managers of robots.")
    return render_template("supervise.html")

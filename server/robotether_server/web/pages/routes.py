"""/routes: routes between robots and web apps; src/pages/routes.js draws them and shows how they are."""

from flask import Blueprint, render_template, request
from robotether_common.own_topics import same_type

from robotether_server.api.context import context
from robotether_server.contract.routes import end_words
from robotether_server.db import Transaction, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.routes import is_app
from robotether_server.problems import FieldInvalidError, RobotetherError
from robotether_server.schemas import APP
from robotether_server.services import routes
from robotether_server.services.routes import MAX_HOURS, MAX_RATE_HZ, USUAL_RATE_HZ, RouteRequest
from robotether_server.web import current_user, forms
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("routes", __name__, url_prefix="/routes")
blueprint.before_request(current_user.require_user)

PAGE = "/routes"
# Maximum number of robots that the diagram unfolds beside those of routes: each has its topics twice.
MOST_UNFOLDED = 3
# Maximum length of a robot or an app, a topic, a type and a MAC, with spaces between.
MAX_END = len(APP) + 63 + 1 + 255 + 1 + 255 + 1 + 17


@blueprint.get("")
def show(problem: RobotetherError | None = None) -> str:
    """Show the routes that the user may see, and the robots from and to which the user may make some."""
    user = current_user.get()
    with context().database.transaction() as tx:
        present = routes.list_seen(tx, user)
        seen = seen_robots.list_seen(tx, user)
    return render_template(
        "routes.html",
        routes=present,
        robots=[each for each in seen if each.level == "manage" and each.robot.state == "active"],
        most_unfolded=MOST_UNFOLDED,
        routed={
            name for each in present if each.ended_at is None for name in (each.source, each.target)
        },
        end_words=end_words,
        usual_rate_hz=USUAL_RATE_HZ,
        problem=problem,
        values=request.form,
    )


@form(blueprint, "", show)
def make(tx: Transaction, source: Source) -> Saved:
    """Make a route between the two topics that the form names, each with its robot or app, and its type."""
    start, end = _end("from", "From"), _end("to", "To")
    # The type is the robot's; an app may spell it as either ROS does.
    kind = end[2] if is_app(start[0]) else start[2]
    spelled = same_type if is_app(start[0]) != is_app(end[0]) else str
    if spelled(start[2]) != spelled(end[2]):
        raise FieldInvalidError(
            f"cannot make the route: {start[1]} has the type {start[2]}, and {end[1]} {end[2]}",
            "to",
        )
    hours = forms.optional_number("hours", "Hours", 1, MAX_HOURS)
    rate = forms.number("rate_hz", "Messages a second", 1, int(MAX_RATE_HZ))
    macs = start[3], end[3]
    route_request = RouteRequest(start[0], start[1], end[0], end[1], kind, rate, hours, macs)
    route = routes.make(tx, source, current_user.get(), route_request)
    return PAGE, f"The route from {route.source} to {route.target} is made."


@form(blueprint, "/<int:route_id>/remove", lambda route_id, problem=None: show(problem))
def remove(tx: Transaction, source: Source, route_id: int) -> Saved:
    """Remove a route."""
    route = routes.remove(tx, source, current_user.get(), route_id)
    return PAGE, f"The route from {route.source} to {route.target} is removed."


def _end(name: str, label: str) -> tuple[str, str, str, str | None]:
    """Return the robot or app, topic and type that a choice names, and the robot's MAC."""
    words = forms.text(name, label, MAX_END).split(" ")
    if len(words) not in {3, 4}:
        raise FieldInvalidError(f"cannot use {label}: choose a topic", name)
    return words[0], words[1], words[2], words[3] if words[3:] else None

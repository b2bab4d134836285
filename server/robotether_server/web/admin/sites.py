"""/admin/sites: sites of robots; a grant can be for all robots of a site. /admin/sites/NAME: one of them."""

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db import grants, seen_robots
from robotether_server.db.grants import LEVELS
from robotether_server.problems import Problem
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin import grant_lists, robot_pages
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("sites", __name__)

PageAnswer = AnyResponse | str | tuple[str, int]


@blueprint.get("/sites")
def show_all() -> str:
    """Show every site."""
    return _list()


@blueprint.post("/sites")
def add() -> PageAnswer:
    """Add a site."""
    try:
        name = forms.text("name", "Name", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            grant_service.add_site(tx, current_user.source(), name)
    except Problem as problem:
        return _list(problem), problem.status
    return confirmation.go_on(page_of(name), f"Site {name} is added. Add robots and grants to it.")


@blueprint.get("/sites/<name>")
def show(name: str) -> str:
    """Show one site."""
    return render(name)


@blueprint.route("/sites/<name>/robots", methods=METHODS)
def place_here(name: str) -> PageAnswer:
    """Put a robot at this site."""
    if request.method == "GET":
        return render(name)
    try:
        robot = forms.text("robot", "Robot", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            grant_service.place_robot(tx, current_user.source(), robot, name)
    except Problem as problem:
        return render(name, problem), problem.status
    return confirmation.go_on(page_of(name), f"Robot {robot} is at site {name}.")


@blueprint.route("/sites/<name>/robots/<robot>/take-out", methods=METHODS)
def remove_robot(name: str, robot: str) -> AnyResponse:
    """Put a robot of this site at no site."""
    action = ConfirmedAction(
        title=f"Remove robot {robot} from site {name}?",
        effects=(
            f"Users lose what only the grants for site {name} allow on {robot}. Connections that need them are cut "
            "within 2 seconds; if one of them drives the robot, it stops by itself.",
        ),
        undo=f"Add {robot} again.",
        button="Remove",
        done=f"Robot {robot} is at no site.",
        back=page_of(name),
    )
    return confirmation.run(
        action, lambda tx, source: grant_service.remove_robot(tx, source, robot, name)
    )


@blueprint.route("/robots/<name>/site", methods=METHODS)
def place(name: str) -> PageAnswer:
    """Put this robot at a site, or at none."""
    if request.method == "GET":
        return robot_pages.render(name)
    try:
        site = forms.optional_text("site", "Site", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            grant_service.place_robot(tx, current_user.source(), name, site)
    except Problem as problem:
        return robot_pages.render(name, problem), problem.status
    words = f"at site {site}" if site else "at no site"
    return confirmation.go_on(robot_pages.page_of(name), f"Robot {name} is {words}.")


@blueprint.route("/sites/<name>/remove", methods=METHODS)
def remove(name: str) -> AnyResponse:
    """Remove a site."""
    with context().database.transaction() as tx:
        found = grants.get_site(tx, name)
    action = ConfirmedAction(
        title=f"Remove site {name}?",
        effects=(
            "The grants for it are removed with it; connections that need them are cut within 2 seconds.",
            f"Its robots stay, at no site: {', '.join(found.robots) or 'none'}.",
        ),
        undo="A removed site cannot be restored; add it again, with robots and grants.",
        button="Remove",
        done=f"Site {name} is removed.",
        back=page_of(name),
        onward="/admin/sites",
    )
    return confirmation.run(action, lambda tx, source: grant_service.remove_site(tx, source, name))


def render(name: str, problem: Problem | None = None) -> str:
    """Return the page of a site, with the problem of one of its forms; raise RecordMissing."""
    with context().database.transaction() as tx:
        site = grants.get_site(tx, name)
        elsewhere = [one.robot for one in seen_robots.list_all(tx) if one.robot.site != name]
        return render_template(
            "admin/site.html",
            site=site,
            others=elsewhere,
            grants=grant_lists.for_site(tx, name),
            choices=grant_lists.holders(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


def page_of(name: str) -> str:
    """Return the path of a site's page."""
    return f"/admin/sites/{name}"


def _list(problem: Problem | None = None) -> str:
    with context().database.transaction() as tx:
        found = grants.list_sites(tx)
    return render_template("admin/sites.html", sites=found, problem=problem, values=request.form)

"""/admin/sites: sites of robots; a grant can be for all robots of a site. /admin/sites/NAME: one of them."""

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, join_tokens, seen_robots
from robotether_server.db import grants as db_grants
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS
from robotether_server.db.join_tokens import Place
from robotether_server.problems import RobotetherError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.web import confirmation, forms
from robotether_server.web.admin import grants
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("sites", __name__, url_prefix="/sites")


def show_all(problem: RobotetherError | None = None) -> str:
    """Show every site."""
    with context().database.transaction() as tx:
        sites = db_grants.list_sites(tx)
    return render_template("admin/sites.html", sites=sites, problem=problem, values=request.form)


@form(blueprint, "", show_all)
def add(tx: Transaction, source: Source) -> Saved:
    """Add a site."""
    name = forms.text("name", "Name", MAX_NAME_LENGTH)
    grant_service.add_site(tx, source, name)
    return page_of(name), f"Site {name} is added. Add robots and grants to it."


@blueprint.get("/<name>")
def show(name: str, problem: RobotetherError | None = None) -> str:
    """Show one site, with the problem of one of its forms."""
    with context().database.transaction() as tx:
        site = db_grants.get_site(tx, name)
        robots = [seen.robot for seen in seen_robots.list_all(tx) if seen.robot.site != name]
        return render_template(
            "admin/site.html",
            site=site,
            others=[
                (robot.name, f"{robot.name} (now at {robot.site})" if robot.site else robot.name)
                for robot in robots
            ],
            grants=grants.for_site(tx, name),
            choices=grants.holders(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


@form(blueprint, "/<name>/robots", show)
def place_here(tx: Transaction, source: Source, name: str) -> Saved:
    """Put a robot at this site."""
    robot = forms.text("robot", "Robot", MAX_NAME_LENGTH)
    grant_service.place_robot(tx, source, robot, name)
    return page_of(name), f"Robot {robot} is at site {name}."


def page_of(name: str) -> str:
    """Return the path of a site's page."""
    return f"/admin/sites/{name}"


def _words(name: str, robot: str = "") -> Words:
    with context().database.transaction() as tx:
        site = db_grants.get_site(tx, name)
        tokens = ", ".join(join_tokens.names_for(tx, Place(site=name)))
    return {
        "name": name,
        "robot": robot,
        "robots": ", ".join(site.robots) or "none",
        "tokens": tokens and f"Robots that join with these tokens will be at no site: {tokens}.",
    }


grants.register_form(blueprint, "/<name>/grants", show, page_of)
confirmation.register(
    blueprint,
    "/admin/sites/{name}",
    _words,
    ConfirmedAction(
        path="/<name>/robots/<robot>/take-out",
        title="Remove robot {robot} from site {name}?",
        effects=(
            "Users lose what only the grants for site {name} allow on {robot}. Connections that need them are cut "
            "within 2 seconds; if one of them drives the robot, it stops by itself.",
        ),
        undo="Add {robot} again.",
        button="Remove",
        done="Robot {robot} is at no site.",
        do=lambda tx, source, name, robot: grant_service.remove_robot(tx, source, robot, name),
    ),
    ConfirmedAction(
        path="/<name>/remove",
        title="Remove site {name}?",
        effects=(
            "The grants for it are removed with it; connections that need them are cut within 2 seconds.",
            "Its robots stay, at no site: {robots}.",
            "{tokens}",
        ),
        undo="A removed site cannot be restored; add it again, with robots and grants.",
        button="Remove",
        done="Site {name} is removed.",
        do=grant_service.remove_site,
        onward="/admin/sites",
    ),
)

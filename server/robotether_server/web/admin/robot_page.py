"""/admin/robots/NAME: all that is known of one robot, and the way to everything that can be done with it."""

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, audit, control_states, robots, sessions, sites
from robotether_server.db.grants import LEVELS
from robotether_server.db.robots import SeenRobot
from robotether_server.problems import Problem, RobotUnknown
from robotether_server.web import current_user
from robotether_server.web.admin import grant_lists, robot_setting_texts

blueprint = Blueprint("robot_page", __name__)

SHOWN = 20


@blueprint.get("/robots/<name>")
def show(name: str) -> str:
    """Show the robot."""
    return render(name)


def render(name: str, problem: Problem | None = None) -> str:
    """Return the page of a robot, with what went wrong in one of its forms; raise RobotUnknown."""
    with context().database.transaction() as tx:
        seen = find(tx, name)
        return render_template(
            "admin/robot.html",
            seen=seen,
            robot=seen.robot,
            sessions=sessions.of_robot(tx, seen.robot.id, SHOWN),
            events=audit.find(tx, audit.AuditSearch(robot=name), limit=SHOWN),
            grants=grant_lists.for_robot(tx, seen.robot),
            choices=grant_lists.holders(tx),
            sites=[site.name for site in sites.list_all(tx)],
            settings=robot_setting_texts.summary(seen.robot.settings),
            control=control_states.of_robot(tx, seen.robot.id),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


def get(name: str) -> SeenRobot:
    """Return the robot that a page is about; raise RobotUnknown."""
    with context().database.transaction() as tx:
        return find(tx, name)


def find(tx: Transaction, name: str) -> SeenRobot:
    """Return the robot of that name, as an admin sees it; raise RobotUnknown."""
    seen = robots.find_seen(tx, current_user.get(), name)
    if seen is None:
        raise RobotUnknown(
            f"cannot show robot {name}: there is none of that name; perhaps it was renamed or removed"
        )
    return seen


def page_of(name: str) -> str:
    """Return the path of a robot's page."""
    return f"/admin/robots/{name}"

"""/admin/robots: every robot, found by words and state, and the page of each; /admin/add-robot: announce one."""

from dataclasses import dataclass

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db import Transaction, audit, grants, seen_robots
from robotether_server.db.grants import LEVELS
from robotether_server.db.seen_robots import FREE, ControlState, SeenRobot
from robotether_server.problems import Problem, RobotUnknown
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import robots as robot_service
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin import grant_lists, robot_setting_fields

blueprint = Blueprint("robot_pages", __name__)

MAX_SHOWN = 200
MAX_MAC_LENGTH = 17
STATES = (
    ("", "All"),
    ("online", "Online"),
    ("offline", "Offline"),
    ("active", "Active"),
    ("pending", "Announced or waiting"),
    ("disabled", "Disabled"),
    ("stopped", "Stopped"),
    ("driven", "Driven now"),
)


SHOWN = 20


@dataclass(frozen=True)
class RobotSearch:
    """A filter of robots: words that all must occur in the row, and a state of STATES."""

    words: str = ""
    state: str = ""

    def finds(self, seen: SeenRobot, control: ControlState = FREE) -> bool:
        """Tell whether a robot matches."""
        if self.state and self.state not in _states(seen, control):
            return False
        row = " ".join(_searched(seen)).lower()
        return all(word in row for word in self.words.lower().split())


def _states(seen: SeenRobot, control: ControlState) -> list[str]:
    presence = "online" if seen.online else "offline"
    stopped = ["stopped"] if control.stopped else []
    return [presence, seen.robot.state, *stopped, *(["driven"] if control.driver else [])]


def _searched(seen: SeenRobot) -> list[str]:
    robot = seen.robot
    texts = [robot.name, robot.mac, robot.mac.replace(":", "-"), robot.mac.replace(":", "")]
    report = [robot.report.hostname, robot.report.address] if robot.report else []
    return [*texts, *report, seen.address or "", robot.site or ""]


@blueprint.get("/robots")
def show_all() -> str:
    """Show the robots that the search finds."""
    search = RobotSearch(request.args.get("q", "").strip(), request.args.get("state", ""))
    with context().database.transaction() as tx:
        everyone = seen_robots.list_seen(tx, current_user.get())
        control = seen_robots.control_of_all(tx)
    found = [seen for seen in everyone if search.finds(seen, control.get(seen.robot.id, FREE))]
    return render_template(
        "admin/robots.html",
        robots=found[:MAX_SHOWN],
        found=len(found),
        total=len(everyone),
        search=search,
        states=STATES,
        control=control,
    )


@blueprint.get("/add-robot")
def show_form() -> str:
    """Show the form."""
    return _form()


@blueprint.post("/add-robot")
def add() -> AnyResponse | tuple[str, int]:
    """Announce a robot by its MAC and name."""
    try:
        mac = forms.text("mac", "MAC address", MAX_MAC_LENGTH)
        name = forms.text("name", "Name", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            robot = robot_service.add(
                tx, current_user.source(), mac, name, allow_local_mac=forms.is_ticked("local_mac")
            )
    except Problem as problem:
        return _form(problem), problem.status
    return confirmation.go_on(
        f"/admin/robots/{robot.name}",
        f"Robot {robot.name} is announced. It waits for the machine with MAC {robot.mac}.",
    )


def _form(problem: Problem | None = None) -> str:
    policy = context().join.policy
    return render_template(
        "admin/add_robot.html", problem=problem, values=request.form, policy=policy
    )


@blueprint.get("/robots/<name>")
def show(name: str) -> str:
    """Show the robot."""
    return render(name)


def render(name: str, problem: Problem | None = None) -> str:
    """Return the page of a robot, with the problem of one of its forms; raise RobotUnknown."""
    with context().database.transaction() as tx:
        seen = find(tx, name)
        return render_template(
            "admin/robot.html",
            seen=seen,
            robot=seen.robot,
            sessions=seen_robots.sessions_of(tx, seen.robot.id, SHOWN),
            events=audit.find(tx, audit.AuditSearch(robot=name), limit=SHOWN),
            grants=grant_lists.for_robot(tx, seen.robot),
            choices=grant_lists.holders(tx),
            sites=[site.name for site in grants.list_sites(tx)],
            settings=robot_setting_fields.summary(seen.robot.settings),
            control=seen_robots.control_of(tx, seen.robot.id),
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
    seen = seen_robots.find_seen(tx, current_user.get(), name)
    if seen is None:
        raise RobotUnknown(
            f"cannot show robot {name}: there is none of that name; it may have been renamed or removed"
        )
    return seen


def page_of(name: str) -> str:
    """Return the path of a robot's page."""
    return f"/admin/robots/{name}"

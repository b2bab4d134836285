"""/admin/robots: every robot, found by words and state.

/admin/robots/NAME: one of them in tabs, and what an admin changes after a question.
"""

from dataclasses import dataclass
from functools import partial

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, audit, cells, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS, SITES
from robotether_server.db.robots import RobotRow
from robotether_server.db.seen_robots import FREE, ControlState, SeenRobot
from robotether_server.problems import FieldInvalidError, RobotetherError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.services import robots
from robotether_server.settings.robot import put_path, remove_path
from robotether_server.web import confirmation, current_user, filters, forms
from robotether_server.web.admin import grants
from robotether_server.web.admin.selection import Selection
from robotether_server.web.confirmation import ConfirmedAction, Field, Words
from robotether_server.web.forms import Saved, form
from robotether_server.web.pages import setting_fields

ROBOTS = Selection(
    "robot", lambda tx: {seen.robot.mac: seen.robot.name for seen in seen_robots.list_all(tx)}
)
blueprint = Blueprint("robots", __name__)

# Maximum number of sessions in a robot's history, and of sessions and events at first.
MAX_SHOWN = 200
MAX_ROWS = 10
MAX_MAC_LENGTH = 17
MAX_USER_LENGTH = 32
LOWEST_PORT, HIGHEST_PORT = 1024, 65535
STATES = (
    ("", "All"),
    ("online", "Online"),
    ("offline", "Offline"),
    ("active", "Active"),
    ("pending", "Announced or awaiting approval"),
    ("disabled", "Disabled"),
    ("stopped", "Stopped"),
    ("driven", "Driven now"),
)


@dataclass(frozen=True)
class RobotSearch:
    """A filter of robots: words that all must occur in the row, and a state of STATES."""

    words: str = ""
    state: str = ""

    def finds(self, seen: SeenRobot, control: ControlState = FREE) -> bool:
        """Return whether a robot matches."""
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
    if search.state not in dict(STATES):
        states = ", ".join(state for state, _ in STATES if state)
        raise FieldInvalidError(f"cannot use state {search.state!r}: it must be one of {states}")
    with context().database.transaction() as tx:
        everyone = seen_robots.list_seen(tx, current_user.get())
        control = seen_robots.control_of_all(tx)
        sites = SITES.names(tx)
        holders = grants.holders(tx)
    hits = [seen for seen in everyone if search.finds(seen, control.get(seen.robot.id, FREE))]
    ticked = ROBOTS.of_list(seen.robot.mac for seen in everyone)
    last_page = max(len(hits) - 1, 0) // filters.PER_PAGE
    first = min(max(request.args.get("page", 1, type=int) - 1, 0), last_page) * filters.PER_PAGE
    rows = hits[first : first + filters.PER_PAGE]
    return render_template(
        "admin/robots.html",
        robots=rows,
        first=first,
        pages=_pages(search, first, len(hits)),
        ticked=ticked,
        others=[mac for mac in ticked if mac not in {seen.robot.mac for seen in rows}],
        found=len(hits),
        total=len(everyone),
        sites=sites,
        holders=holders,
        levels=LEVELS,
        ends=grants.ENDS,
        search=search,
        states=STATES,
        control=control,
    )


def _pages(search: RobotSearch, first: int, count: int) -> list[tuple[str, str]]:
    """Return words and links of the pages before and after the one that begins with the robot at `first`."""
    words = {"q": search.words, "state": search.state}
    number = first // filters.PER_PAGE + 1
    return [
        (title, filters.link("/admin/robots", words, page=page))
        for title, page, is_there in (
            ("Previous", number - 1, first > 0),
            ("Next", number + 1, first + filters.PER_PAGE < count),
        )
        if is_there
    ]


@blueprint.get("/robots/<name>")
def show(name: str, problem: RobotetherError | None = None) -> str:
    """Show the overview of one robot, with the problem of its form."""
    with context().database.transaction() as tx:
        seen = find(tx, name)
        return render_template(
            "admin/robot.html",
            seen=seen,
            robot=seen.robot,
            sites=SITES.names(tx),
            regions=_regions(tx, seen.robot),
            settings=setting_fields.summary(seen.robot.settings),
            control=seen_robots.control_of(tx, seen.robot.id),
            problem=problem,
        )


@blueprint.get("/robots/<name>/access")
def show_access(name: str, problem: RobotetherError | None = None) -> str:
    """Show the grants for one robot, with the problem of their form."""
    with context().database.transaction() as tx:
        seen = find(tx, name)
        return render_template(
            "admin/robot_access.html",
            seen=seen,
            robot=seen.robot,
            grants=grants.for_robot(tx, seen.robot),
            choices=grants.holders(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


@blueprint.get("/robots/<name>/history")
def show_history(name: str) -> str:
    """Show the last sessions and events of one robot; ?sessions=all shows more sessions."""
    limit = MAX_SHOWN if request.args.get("sessions") == "all" else MAX_ROWS
    with context().database.transaction() as tx:
        seen = find(tx, name)
        # One more than is shown: it shows whether there are more.
        sessions = seen_robots.sessions_of(tx, seen.robot.id, limit + 1)
        return render_template(
            "admin/robot_history.html",
            seen=seen,
            robot=seen.robot,
            sessions=sessions[:limit],
            has_more=len(sessions) > limit,
            limit=limit,
            max_shown=MAX_SHOWN,
            events=audit.find(tx, audit.AuditSearch(robot=name), limit=MAX_ROWS),
        )


@form(blueprint, "/robots/<name>/site", show)
def place(tx: Transaction, source: Source, name: str) -> Saved:
    """Put this robot at a site, or at none."""
    site = forms.optional_text("site", "Site", MAX_NAME_LENGTH)
    grant_service.place_robot(tx, source, name, site)
    return page_of(name), f"Robot {name} is {f'at site {site}' if site else 'at no site'}."


@form(blueprint, "/robots/<name>/region", show)
def set_region(tx: Transaction, source: Source, name: str) -> Saved:
    """Put this robot into a region, or into none."""
    region = forms.optional_text("region", "Region", MAX_NAME_LENGTH)
    _set_or_remove(tx, source, name, "region", region)
    return page_of(name), f"Robot {name} is in {f'region {region}' if region else 'no region'}."


def _regions(tx: Transaction, robot: RobotRow) -> list[str]:
    """Return the regions to choose from; none at a site without regions."""
    own = [] if robot.region is None else [robot.region]
    return sorted({*cells.list_regions(tx), *own})


def page_of(name: str) -> str:
    """Return the path of a robot's page."""
    return f"/admin/robots/{name}"


def find(tx: Transaction, name: str) -> SeenRobot:
    """Return the robot of that name, as an admin sees it; raise RobotUnknownError."""
    return seen_robots.require(tx, current_user.get(), name, "manage", "show")


def confirmation_words(name: str) -> Words:
    """Return what the texts of actions name; raise RobotUnknownError."""
    with context().database.transaction() as tx:
        robot = find(tx, name).robot
    shell_user = robot.settings.get("shell_user", "")
    return {"robot": robot, "name": name, "meant": robot.mac, "shell_user": shell_user}


def _rename(tx: Transaction, source: Source, name: str) -> RobotRow:
    new_name = forms.robot_name("new_name", "New name")
    with forms.named({"name": "new_name"}):
        return robots.rename(tx, source, name, new_name)


def _set_mac(tx: Transaction, source: Source, name: str) -> None:
    mac = forms.text("mac", "MAC address", MAX_MAC_LENGTH)
    robots.set_mac(tx, source, name, mac, allow_local_mac=forms.is_ticked("local_mac"))


def _move_ports(tx: Transaction, source: Source, name: str) -> None:
    ros_port = forms.optional_number("ros_port", "rosbridge port", LOWEST_PORT, HIGHEST_PORT)
    video_port = forms.optional_number("video_port", "Video port", LOWEST_PORT, HIGHEST_PORT)
    robots.move_ports(tx, source, name, ros_port, video_port)


def _set_shell_user(tx: Transaction, source: Source, name: str) -> None:
    user = forms.optional_text("shell_user", "Shell user", MAX_USER_LENGTH)
    _set_or_remove(tx, source, name, "shell_user", user)


def _set_or_remove(
    tx: Transaction, source: Source, name: str, path: str, value: str | None
) -> None:
    change = partial(put_path, path=path, value=value) if value else partial(remove_path, path=path)
    robots.change_settings(tx, source, name, change)


grants.register_form(blueprint, "/robots/<name>/grants", show_access, grants.page_of_robot)
confirmation.register(
    blueprint,
    "/admin/robots/{name}",
    confirmation_words,
    ConfirmedAction(
        path="/robots/<name>/disable",
        title="Disable robot {name}?",
        effects=(
            "{name} is cut off within 2 seconds: drivers and viewers are disconnected, and it stops by itself.",
            "It is rejected until it is enabled again. Name, ports, grants and an approved key stay.",
            "A key that nobody has approved yet is forgotten.",
        ),
        undo="Enable the robot on its page. It reconnects by itself.",
        button="Disable",
        done="Robot {name} is disabled.",
        do=robots.disable,
    ),
    ConfirmedAction(
        path="/robots/<name>/enable",
        title="Enable robot {name}?",
        effects=(
            "With its key it reconnects by itself, within a minute.",
            "Without a key it waits for the machine to join and for an admin to approve it.",
        ),
        undo="Disable the robot again.",
        button="Enable",
        done="Robot {name} is enabled.",
        do=robots.enable,
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/robots/<name>/rekey",
        title="Forget the key of robot {name}?",
        effects=(
            "{name} is cut off within 2 seconds. Name, ports and grants stay.",
            "The next key that the machine shows waits for an admin to approve it.",
            "Use this when the machine has a new disk, or when somebody else may have its key.",
        ),
        undo="A forgotten key cannot be restored. The robot joins again by itself, and you approve its key.",
        button="Forget the key",
        done="Robot {name} has no key now. Approve the next one when it waits.",
        do=robots.rekey,
    ),
    ConfirmedAction(
        path="/robots/<name>/rotate-key",
        title="Ask robot {name} for a new key?",
        effects=(
            "Its agent makes a new key and proves with the old one that it is the same robot. Nothing is disconnected.",
            "An offline robot does so when it is back.",
        ),
        undo="A robot that has changed its key does not return to the old one; ask for another one at any time.",
        button="Ask for a new key",
        done="Robot {name} is asked for a new key.",
        do=robots.rotate_key,
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/robots/<name>/shell-on",
        title="Turn the shell of robot {name} on?",
        effects=(
            "Admins, and users with a grant to manage it, reach the SSH port of this robot through the server.",
            "They need an SSH key in their profile here, and an account on the robot that accepts it.",
        ),
        undo="Turn the shell off again.",
        button="Turn on",
        done="The shell of robot {name} is on.",
        do=partial(robots.set_shell, on=True),
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/robots/<name>/shell-off",
        title="Turn the shell of robot {name} off?",
        effects=(
            "SSH connections to {name} are cut within 2 seconds, including copies and playbooks that are running.",
            "The robot reconnects, so drivers and viewers are interrupted for a moment.",
            "Its shell port is free for another robot.",
        ),
        undo="Turn the shell on again. It may get another port: people then download their SSH configuration again.",
        button="Turn off",
        done="The shell of robot {name} is off.",
        do=partial(robots.set_shell, on=False),
    ),
    ConfirmedAction(
        path="/robots/<name>/remove",
        title="Remove robot {name}?",
        effects=(
            "The record of {name} (MAC {robot.mac}) is deleted, with its key, ports, grants, settings and sessions.",
            "It is disconnected within 2 seconds. The audit log stays.",
            "An agent that still runs on the machine asks again and waits as an unknown robot; to stop that, "
            "retire the machine first, or disable the robot instead.",
        ),
        undo="A removed robot cannot be restored; announce it or let it join again, then give the grants again.",
        button="Remove",
        done="Robot {name} is removed.",
        do=robots.remove,
        onward="/admin/robots",
    ),
    ConfirmedAction(
        path="/robots/<name>/rename",
        title="Rename robot {name}",
        effects=(
            "Its tunnel stays; drivers have to open it by its new name.",
            "Links, programs and SSH configurations with the old name no longer find it.",
            "Key, ports and grants stay.",
        ),
        undo="Rename it back to {name}, unless another robot has taken that name.",
        button="Rename",
        done="Robot {name} is now {result.name}.",
        do=_rename,
        onward="/admin/robots/{result.name}",
        fields=(
            Field(
                "new_name",
                "New name",
                "{name}",
                "Use a-z, 0-9 and -; begin and end with a letter or digit.",
            ),
        ),
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/robots/<name>/mac",
        title="Change the MAC of robot {name}",
        effects=(
            "For a robot that got a new network card. Name, key, ports, grants and tunnel stay.",
            "A machine that shows the current MAC {robot.mac} becomes an unknown robot.",
        ),
        undo="Change it back to {robot.mac}.",
        button="Change the MAC",
        done="Robot {name} has another MAC.",
        do=_set_mac,
        fields=(
            Field("mac", "MAC address", "{robot.mac}", "in any usual spelling: 00:1b:44:11:3a:b7"),
            Field(
                "local_mac",
                "It may be locally administered",
                hint="Made up by software; two machines may have the same.",
                kind="box",
            ),
        ),
    ),
    ConfirmedAction(
        path="/robots/<name>/ports",
        title="Move the ports of robot {name}",
        effects=(
            "Now: {robot.ros_port} (rosbridge) and {robot.video_port} (video).",
            "{name} reconnects within seconds: drivers and viewers are interrupted, and it stops by itself.",
            "Pages of this site find it again by themselves; programs that use the ports directly do not.",
        ),
        undo="Move them back to {robot.ros_port} and {robot.video_port}, unless another robot has taken them.",
        button="Move",
        done="The ports of robot {name} are moved.",
        do=_move_ports,
        fields=(
            Field(
                "ros_port",
                "rosbridge port",
                hint="Leave both empty for a free pair.",
                kind="number",
            ),
            Field("video_port", "Video port", kind="number"),
        ),
    ),
    ConfirmedAction(
        path="/robots/<name>/shell-user",
        title="Shell user of robot {name}",
        effects=(
            "The account on the robot that the SSH configuration names, such as pi or ubuntu.",
            "Empty: everybody's own user name. People download their SSH configuration again to get the change.",
        ),
        undo="Set it back at any time.",
        button="Save",
        done="The shell user of robot {name} is saved.",
        do=_set_shell_user,
        fields=(Field("shell_user", "Shell user", "{shell_user}"),),
        is_harmless=True,
    ),
)

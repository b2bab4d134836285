"""The pages that people see: log in, the fleet as cards and as a wall of pictures, one robot to drive.

A person without a login is redirected to the log-in page and back.
"""

from collections.abc import Callable
from http import HTTPStatus
from urllib.parse import urlsplit

from flask import (
    Blueprint,
    Response,
    current_app,
    g,
    make_response,
    redirect,
    render_template,
    request,
    session,
)
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.contract.codes import DRIVE_ENDS, REFUSALS
from robotether_server.db import Transaction, seen_robots
from robotether_server.db.audit import MAX_ACTOR_LENGTH, Source
from robotether_server.db.seen_robots import SeenRobot
from robotether_server.problems import (
    FieldInvalidError,
    LoginFailedError,
    OriginRefusedError,
    RobotUnknownError,
    ThrottledError,
)
from robotether_server.services import logging_in
from robotether_server.settings import robot as robot_settings
from robotether_server.times import rfc3339
from robotether_server.web import current_user, forms

blueprint = Blueprint("pages", __name__)


@blueprint.get("/healthz")
def healthz() -> str:
    """Answer while this process runs; the database has a health check of its own."""
    return "ok\n"


@blueprint.get("/healthz/database")
def database_health() -> str:
    """Answer while the database does; nginx asks for whoever watches the site from outside."""
    with context().database.transaction(briefly=True) as tx:
        tx.row("SELECT 1")
    return "ok\n"


@blueprint.get("/favicon.ico")
def favicon() -> Response:
    """Send the icon to browsers that ask before they have read a page."""
    return current_app.send_static_file("icons/robotether.svg")


@blueprint.get("/login")
def show_login() -> AnyResponse:
    """Show the form, or go on when there is a login."""
    with context().database.transaction() as tx:
        user = auth.page_user(tx, request)
    if user is not None:
        return redirect(_next_page())
    return make_response(render_template("login.html", onward=_next_page()))


@blueprint.post("/login")
def log_in() -> AnyResponse:
    """Log in and go on to the page that was asked for."""
    name = request.form.get("name", "").strip()[:MAX_ACTOR_LENGTH]
    next_page, waiting_form = _next_page(), forms.carry()
    source = Source(name, request.remote_addr)
    password = forms.secret("password")
    try:
        _check_host()
        unused = context().login_lifetime.unused
        text = logging_in.log_in(context().database, source, password, unused)
    except (LoginFailedError, OriginRefusedError, ThrottledError) as problem:
        throttled = isinstance(problem, ThrottledError)
        context().metrics.count_login("throttled" if throttled else "refused")
        problem.field = "password"
        page = render_template("login.html", onward=next_page, kept=waiting_form, error=problem)
        response = make_response(page)
        response.status_code = problem.status
        if isinstance(problem, ThrottledError):
            response.headers["Retry-After"] = str(problem.retry_after_s)
        return response
    context().metrics.count_login("accepted")
    # Form tokens of the time before the login end with it.
    session.clear()
    if waiting_form is None:
        onward = redirect(next_page, HTTPStatus.SEE_OTHER)
    else:
        detail = f"You are logged in as {name}. Send your form."
        page = render_template(
            "problem.html",
            title="Form not sent yet",
            detail=detail,
            kept=waiting_form,
            onward=next_page,
        )
        onward = make_response(page)
    auth.set_login(onward, text)
    return onward


def _check_host() -> None:
    """Raise OriginRefusedError if the browser sees another host than this server: driving and Stop would fail."""
    seen = urlsplit(request.headers.get("Origin", "")).netloc.lower()
    ours = request.host.lower().removesuffix(":443")
    if seen and seen.removesuffix(":443") != ours:
        raise OriginRefusedError(
            f"cannot serve {seen[:100]!r}: a proxy in front changes the header Host to {ours[:100]!r}, and "
            "nobody could drive or stop a robot; let it pass Host on unchanged"
        )


@blueprint.post("/logout")
def log_out() -> AnyResponse:
    """End the login, here and in the database."""
    text = request.cookies.get(auth.COOKIE, "")
    with context().database.transaction() as tx:
        user = auth.page_user(tx, request)
    if user is not None:
        logging_in.log_out(context().database, Source(user.name, request.remote_addr), text)
    session.clear()
    onward = redirect("/login", HTTPStatus.SEE_OTHER)
    auth.clear_login(onward)
    return onward


@blueprint.get("/")
def show_fleet() -> AnyResponse:
    """Show the robots that the user may see; /api/v1/events updates the page."""
    return _page_of_robots(
        "fleet.html",
        lambda tx, seen: {
            "robots": [_card(robot) for robot in seen],
            "machines": _other_machines(tx),
        },
    )


@blueprint.get("/wall")
def show_wall() -> AnyResponse:
    """Show pictures of the robots that the user may see, those that ask for help first."""
    return _page_of_robots(
        "wall.html",
        lambda _tx, seen: {"robots": _tiles(seen), "most": context().wall_robots},
    )


def _tiles(seen: list[SeenRobot]) -> dict[str, dict[str, str]]:
    return {
        robot.robot.name: {
            "level": robot.level,
            "camera": _first_camera(robot),
            "mac": robot.robot.mac,
        }
        for robot in seen
    }


def _other_machines(tx: Transaction) -> list[dict[str, str]]:
    """Return the machines of the site whose page this person could open instead, and let this page measure them."""
    others = [
        {"name": cell.name, "authority": site}
        for cell, site in context().other_cells(tx)
        if cell.is_listed
    ]
    g.other_machines = [item["authority"] for item in others]
    return others


def _page_of_robots(
    template: str, describe: Callable[[Transaction, list[SeenRobot]], dict[str, object]]
) -> AnyResponse:
    """Show a page of all robots that the user may see; `describe` gives its template's values."""
    with context().database.transaction() as tx:
        user = auth.page_user(tx, request)
        if user is None:
            return current_user.to_login()
        values = describe(tx, seen_robots.list_seen(tx, user))
        current_user.remember(tx, user)
    return make_response(render_template(template, user=user, **values))


@blueprint.get("/robots/<name>")
def show_robot(name: str) -> AnyResponse:
    """Show the page from which one robot is driven or watched."""
    with context().database.transaction() as tx:
        user = auth.page_user(tx, request)
        if user is None:
            return current_user.to_login()
        seen = seen_robots.find_seen(tx, user, name)
        current_user.remember(tx, user)
    if seen is None:
        raise RobotUnknownError(f"No robot '{name}', or you have no access.")
    robot = {
        "name": name,
        "mac": seen.robot.mac,
        "level": seen.level,
        "settings": _in_force(seen),
    }
    words = {"ends": DRIVE_ENDS, "refusals": REFUSALS}
    return make_response(render_template("drive.html", user=user, robot=robot, words=words))


def _in_force(seen: SeenRobot) -> dict[str, object]:
    """Return all settings, the defaults filled in."""
    try:
        return robot_settings.parse(seen.robot.settings).as_dict()
    except FieldInvalidError:
        # Somebody wrote by SQL what nobody may set; the relay keeps drivers out until it is mended.
        return robot_settings.DEFAULTS.as_dict()


def _card(seen: SeenRobot) -> dict[str, object]:
    return {
        "name": seen.robot.name,
        "mac": seen.robot.mac,
        "state": seen.robot.state,
        "online": seen.online,
        "since": rfc3339(seen.since),
        "offline_reason": seen.offline_reason or "",
        "level": seen.level,
        "site": seen.robot.site,
        "camera": _first_camera(seen),
    }


def _first_camera(seen: SeenRobot) -> str:
    """Return the topic of the camera that the robot's settings name first; empty: the page asks the robot."""
    try:
        cameras = robot_settings.parse(seen.robot.settings).page.cameras
    except FieldInvalidError:
        return ""
    return cameras[0].topic if cameras else ""


def _next_page() -> str:
    """Return where to go on: only a path of this site, or the page could send people anywhere."""
    path = request.values.get("next", "")
    is_ours = path.startswith("/") and path.isprintable() and "\\" not in path
    return path if is_ours and not path.startswith("//") else "/"

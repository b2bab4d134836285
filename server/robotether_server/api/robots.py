"""/api/v1/robots and /api/v1/robots/NAME: robots as a user may see them, and as admins change them."""

from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server import macs
from robotether_server.api import auth, fields
from robotether_server.api.auth import Caller
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.api.fields import Fields
from robotether_server.api.objects import plain, robot_object, ssh_object
from robotether_server.db import control_states, robots, sessions
from robotether_server.db.audit import Source
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.page_settings import NAMES
from robotether_server.problems import FieldInvalid, RobotUnknown
from robotether_server.services import drive_pages, sites
from robotether_server.services import robots as robot_service
from robotether_server.services.enrolment import Registration
from robotether_server.services.enrolment_credentials import EnrolmentCredential
from robotether_server.ssh_keys import MAX_LINE_LENGTH

MAX_HOSTNAME_LENGTH = 253
MAX_VERSION_LENGTH = 32
REGISTRATION = ("mac", "public_key", "hostname", "agent_version")
CHANGES = ("name", "mac", "state", "shell", "settings", "site")
STATES = ("active", "disabled")
USUAL_SESSIONS = 100
MAX_SESSIONS = 500


@blueprint.get("/robots")
def list_robots() -> Response:
    """List the robots that the user may see."""
    with auth.any_user() as caller:
        seen = robots.list_seen(caller.tx, caller.user)
        control = control_states.of_all(caller.tx)
    is_admin = caller.user.is_admin
    shown = [
        robot_object(one, control.get(one.robot.id, control_states.FREE), for_admin=is_admin)
        for one in seen
    ]
    return jsonify({"robots": shown})


@blueprint.get("/robots/<robot>")
def show_robot(robot: str) -> Response:
    """Show one robot; one that the user may not see looks like one that does not exist."""
    with auth.any_user() as caller:
        seen = robots.find_seen(caller.tx, caller.user, robot)
        if seen is None:
            raise RobotUnknown(
                f"cannot show robot {robot}: there is none of that name that you may see"
            )
        control = control_states.of_robot(caller.tx, seen.robot.id)
    return jsonify(robot_object(seen, control, for_admin=caller.user.is_admin))


@blueprint.put("/robots/<robot>")
def register_robot(robot: str) -> tuple[Response, int]:
    """Enrol a robot with its key, or find it enrolled."""
    with context().database.transaction() as tx:
        credential = auth.enrolment_credential(tx, request)
        registration = _registration(robot, credential)
        ssh = ssh_object(context().join)
        source = Source(credential.actor, request.remote_addr)
        _, is_new = robot_service.register(tx, source, registration)
        seen = robots.get_seen(tx, robot)
        # A join token lets robots in; it may not see who drives them.
        control = control_states.of_robot(tx, seen.robot.id) if credential.admin else None
    shown = robot_object(seen, control, for_admin=credential.admin is not None) | {"ssh": ssh}
    if credential.admin is None:
        shown["level"] = None
    return jsonify(shown), HTTPStatus.CREATED if is_new else HTTPStatus.OK


@blueprint.patch("/robots/<robot>")
def change_robot(robot: str) -> Response:
    """Change what is given, all or nothing."""
    with auth.admin() as caller:
        body = fields.json_object(request, CHANGES)
        if not body:
            raise FieldInvalid(f"cannot change robot {robot}: give one of {', '.join(CHANGES)}")
        name = _change(caller, robot, body)
        seen = robots.get_seen(caller.tx, name)
        control = control_states.of_robot(caller.tx, seen.robot.id)
    return jsonify(robot_object(seen, control, for_admin=True))


@blueprint.delete("/robots/<robot>")
def remove_robot(robot: str) -> tuple[str, int]:
    """Remove the robot with its grants and sessions."""
    with auth.admin() as caller:
        robot_service.remove(caller.tx, caller.source, robot)
    return "", HTTPStatus.NO_CONTENT


@blueprint.get("/robots/<robot>/sessions")
def list_sessions(robot: str) -> Response:
    """List the robot's connections, the newest first."""
    with auth.admin() as caller:
        given = fields.query(request, ("limit",))
        limit = fields.number_in_query(given, "limit", 1, MAX_SESSIONS) or USUAL_SESSIONS
        found = sessions.of_robot(caller.tx, robots.get_seen(caller.tx, robot).robot.id, limit)
    return jsonify({"sessions": [plain(asdict(one)) for one in found]})


def _registration(robot: str, credential: EnrolmentCredential) -> Registration:
    body = fields.json_object(request, REGISTRATION)
    return Registration(
        name=robot,
        mac=fields.text(body, "mac", macs.MAX_TEXT_LENGTH),
        public_key=fields.text(body, "public_key", MAX_LINE_LENGTH),
        credential=credential,
        hostname=fields.optional_text(body, "hostname", MAX_HOSTNAME_LENGTH),
        agent_version=fields.optional_text(body, "agent_version", MAX_VERSION_LENGTH),
        allow_local_mac=context().join.allow_local_macs,
    )


def _change(caller: Caller, name: str, body: Fields) -> str:
    """Do what the body says; return the robot's name afterwards, which is changed last."""
    tx, source = caller.tx, caller.source
    if "mac" in body:
        mac = fields.text(body, "mac", macs.MAX_TEXT_LENGTH)
        robot_service.set_mac(
            tx, source, name, mac, allow_local_mac=context().join.allow_local_macs
        )
    if "settings" in body:
        robot_service.set_settings(tx, source, name, fields.mapping(body, "settings"))
    if "site" in body:
        sites.place(tx, source, name, fields.optional_text(body, "site", MAX_NAME_LENGTH))
    if "shell" in body:
        robot_service.set_shell(tx, source, name, fields.flag(body, "shell"))
    if "state" in body:
        _change_state(caller, name, fields.choice(body, "state", STATES))
    if "name" not in body:
        return name
    return robot_service.rename(tx, source, name, fields.text(body, "name", MAX_NAME_LENGTH)).name


def _change_state(caller: Caller, name: str, state: str) -> None:
    if state == "disabled":
        robot_service.disable(caller.tx, caller.source, name)
    elif robots.get(caller.tx, name).state != "active":
        robot_service.enable(caller.tx, caller.source, name)


@blueprint.put("/robots/<robot>/page")
def set_page(robot: str) -> Response:
    """Replace the page's settings; what is missing is as by default."""
    with auth.any_user() as caller:
        drive_pages.find_managed(caller.tx, caller.user, robot)
        body = fields.json_object(request, NAMES)
        settings = drive_pages.set_page(caller.tx, caller.source, robot, body)
    return jsonify(settings.page.as_dict())


@blueprint.put("/robots/<robot>/buttons")
def set_buttons(robot: str) -> Response:
    """Replace the buttons."""
    with auth.any_user() as caller:
        drive_pages.find_managed(caller.tx, caller.user, robot)
        body = fields.json_object(request, ("buttons",))
        settings = drive_pages.set_buttons(caller.tx, caller.source, robot, body.get("buttons"))
    return jsonify({"buttons": [button.as_dict() for button in settings.buttons]})

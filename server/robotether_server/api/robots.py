"""/api/v1/robots and /api/v1/robots/NAME: what users see of robots, and what admins change."""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType, structs

from robotether_server.api.auth import Caller, EnrolmentCaller
from robotether_server.api.context import context
from robotether_server.api.exports import USUAL_LIMIT, Limit
from robotether_server.api.objects import SettingsObject, ShownRobot, Ssh, shown_robot, ssh_of
from robotether_server.api.operations import operation
from robotether_server.buttons import GivenButtons
from robotether_server.db import control_states, robots, sessions
from robotether_server.db.sessions import RecordedSession
from robotether_server.field_types import (
    AT_LEAST_ONE,
    MAX_NAME_LENGTH,
    PLAIN_NAME_PATTERN,
    AgentVersion,
    Hostname,
    Mac,
    PublicKeyLine,
    RobotName,
)
from robotether_server.page_settings import PageSettings
from robotether_server.problems import RobotUnknown
from robotether_server.services import drive_pages, sites
from robotether_server.services import robots as robot_service
from robotether_server.services.enrolment import Registration

SiteName = Annotated[
    str,
    Meta(extra_json_schema={"pattern": PLAIN_NAME_PATTERN}, extra={"longest": MAX_NAME_LENGTH}),
]
PageObject = Annotated[
    dict[str, Any], Meta(extra_json_schema={"$ref": "#/components/schemas/PageSettings"})
]


class RobotList(Struct):
    """Robots, by name."""

    robots: list[ShownRobot]


class NewRegistration(Struct, forbid_unknown_fields=True):
    """A robot to enrol, with its key."""

    mac: Mac
    public_key: PublicKeyLine
    hostname: Hostname | UnsetType = UNSET
    agent_version: AgentVersion | UnsetType = UNSET


class RegisteredRobot(ShownRobot, kw_only=True):
    """A robot, and where its tunnel goes."""

    ssh: Ssh


class RobotChanges(Struct, forbid_unknown_fields=True):
    """Changes of a robot.

    `settings` replaces all settings. `site` null: no site. `shell`: whether the robot has a port for its own sshd.
    """

    name: RobotName | UnsetType = UNSET
    mac: Mac | UnsetType = UNSET
    state: Literal["active", "disabled"] | UnsetType = UNSET
    shell: bool | UnsetType = UNSET
    settings: SettingsObject | UnsetType = UNSET
    site: SiteName | UnsetType | None = UNSET


class SessionQuery(Struct, forbid_unknown_fields=True):
    """The size of the list."""

    limit: Limit | UnsetType = UNSET


class SessionList(Struct):
    """Sessions, newest first."""

    sessions: list[RecordedSession]


class ButtonList(Struct, forbid_unknown_fields=True):
    """The buttons of the drive page."""

    buttons: GivenButtons


@operation("GET", "/robots", "user")
def list_robots(caller: Caller) -> RobotList:
    """List the robots that the user may see, each with its driver and its stop."""
    control = control_states.of_all(caller.tx)
    return RobotList(
        [
            shown_robot(
                one,
                control.get(one.robot.id, control_states.FREE),
                for_admin=caller.user.is_admin,
            )
            for one in robots.list_seen(caller.tx, caller.user)
        ]
    )


@operation("GET", "/robots/<robot>", "user")
def show_robot(caller: Caller, robot: str) -> ShownRobot:
    """Get a robot that the user may see."""
    seen = robots.find_seen(caller.tx, caller.user, robot)
    if seen is None:
        raise RobotUnknown(
            f"cannot show robot {robot}: there is none of that name that you may see"
        )
    control = control_states.of_robot(caller.tx, seen.robot.id)
    return shown_robot(seen, control, for_admin=caller.user.is_admin)


@operation("PUT", "/robots/<robot>", "enroller", problems=(409,))
def register_robot(
    caller: EnrolmentCaller, robot: str, body: NewRegistration
) -> tuple[RegisteredRobot, Literal[200, 201]]:
    """Enrol a robot with its key, as a playbook does.

    With a join token, or as an admin. Repeating the request changes nothing and uses no token up. 200: the robot
    was enrolled already, or its row took the key.
    """
    tx, admin = caller.tx, caller.credential.admin
    registration = Registration(
        name=robot,
        mac=body.mac,
        public_key=body.public_key,
        credential=caller.credential,
        hostname=body.hostname or None,
        agent_version=body.agent_version or None,
        allow_local_mac=context().join.allow_local_macs,
    )
    ssh = ssh_of(context().join)
    _, is_new = robot_service.register(tx, caller.source, registration)
    seen = robots.get_seen(tx, robot)
    # A join token admits robots; it may not see who drives them.
    control = control_states.of_robot(tx, seen.robot.id) if admin else None
    shown = structs.asdict(shown_robot(seen, control, for_admin=admin is not None))
    if admin is None:
        shown["level"] = None
    return RegisteredRobot(**shown, ssh=ssh), 201 if is_new else 200


@operation("PATCH", "/robots/<robot>", "admin", problems=(409,))
def change_robot(
    caller: Caller, robot: str, body: Annotated[RobotChanges, AT_LEAST_ONE]
) -> ShownRobot:
    """Change the given members, all or none."""
    seen = robots.get_seen(caller.tx, _change(caller, robot, body))
    control = control_states.of_robot(caller.tx, seen.robot.id)
    return shown_robot(seen, control, for_admin=True)


@operation("DELETE", "/robots/<robot>", "admin")
def remove_robot(caller: Caller, robot: str) -> None:
    """Remove the robot with its grants and sessions, and end its connection."""
    robot_service.remove(caller.tx, caller.source, robot)


@operation("GET", "/robots/<robot>/sessions", "admin")
def list_sessions(caller: Caller, robot: str, query: SessionQuery) -> SessionList:
    """List the robot's connections, newest first."""
    robot_id = robots.get_seen(caller.tx, robot).robot.id
    return SessionList(sessions.of_robot(caller.tx, robot_id, query.limit or USUAL_LIMIT))


@operation("PUT", "/robots/<robot>/page", "manager", tag="robots")
def set_page(caller: Caller, robot: str, body: PageObject) -> PageSettings:
    """Set the robot's settings of the drive page; for its managers."""
    return drive_pages.set_page(caller.tx, caller.source, robot, body).page


@operation("PUT", "/robots/<robot>/buttons", "manager", tag="robots")
def set_buttons(caller: Caller, robot: str, body: ButtonList) -> ButtonList:
    """Set the buttons of the drive page; for the robot's managers."""
    given = msgspec.to_builtins(body.buttons)
    settings = drive_pages.set_buttons(caller.tx, caller.source, robot, given)
    buttons = [button.as_dict() for button in settings.buttons]
    return msgspec.convert({"buttons": buttons}, ButtonList)


def _change(caller: Caller, name: str, body: RobotChanges) -> str:
    """Apply the changes, the name last; return the robot's name afterwards."""
    tx, source = caller.tx, caller.source
    if body.mac is not UNSET:
        allow_local_mac = context().join.allow_local_macs
        robot_service.set_mac(tx, source, name, body.mac, allow_local_mac=allow_local_mac)
    if body.settings is not UNSET:
        robot_service.set_settings(tx, source, name, body.settings)
    if body.site is not UNSET:
        sites.place(tx, source, name, body.site)
    if body.shell is not UNSET:
        robot_service.set_shell(tx, source, name, body.shell)
    if body.state is not UNSET:
        _change_state(caller, name, body.state)
    if body.name is UNSET:
        return name
    return robot_service.rename(tx, source, name, body.name).name


def _change_state(caller: Caller, name: str, state: str) -> None:
    if state == "disabled":
        robot_service.disable(caller.tx, caller.source, name)
    elif robots.get(caller.tx, name).state != "active":
        robot_service.enable(caller.tx, caller.source, name)

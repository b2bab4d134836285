"""/api/v1/robots: what users see of robots, and what admins change, with the keys that wait.

What only admins may know of a robot is in `_for_admins`, and nowhere else.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType, structs

from robotether_server.api.auth import Caller, EnrolmentCaller
from robotether_server.api.context import context
from robotether_server.api.exports import USUAL_LIMIT, Limit
from robotether_server.api.join import Ssh, ssh_of
from robotether_server.api.operations import operation
from robotether_server.contract.control import RobotQuery
from robotether_server.db import cells, robots, seen_robots
from robotether_server.db.robots import PendingKey, RejectedKey, State
from robotether_server.db.seen_robots import (
    ControlState,
    DrivenBy,
    RecordedSession,
    SeenRobot,
    Stopped,
)
from robotether_server.schemas import (
    AT_LEAST_ONE,
    MAX_NAME_LENGTH,
    PLAIN_NAME_PATTERN,
    AgentVersion,
    Fingerprint,
    Hostname,
    Level,
    Mac,
    PublicKeyLine,
    RobotName,
    Signature,
    Timestamp,
)
from robotether_server.services import grants, pending
from robotether_server.services import robots as robot_service
from robotether_server.services.robots import Registration
from robotether_server.settings.buttons import GivenButtons
from robotether_server.settings.page import PageSettings

CLOSED = Meta(extra_json_schema={"additionalProperties": False})
# Described by this type; the service parses them.
SettingsObject = Annotated[
    dict[str, Any], Meta(extra_json_schema={"$ref": "#/components/schemas/GivenSettings"})
]

SiteName = Annotated[
    str,
    Meta(extra_json_schema={"pattern": PLAIN_NAME_PATTERN}, extra={"longest": MAX_NAME_LENGTH}),
]

PageObject = Annotated[
    dict[str, Any], Meta(extra_json_schema={"$ref": "#/components/schemas/PageSettings"})
]


class ShownRobot(Struct, kw_only=True):
    """A robot, as the caller may see it.

    `since`: the last change of `online`, null if it was never seen. `level`: the user's, null for a join token.
    `shell_port` null: no shell. `driver` and `stopped` are the database's, null for nobody, and missing in the answer
    to a join token; they lag behind those of /control and /events, which say whether the guard has confirmed a stop,
    and stay while the relay is down. Members after `stopped` are for admins only. `agent_version` and `address` are the
    newest session's, else the join's. `rotate_key`: the robot is asked for a new key.
    """

    name: RobotName
    mac: str
    state: State
    online: bool
    since: Timestamp | None
    level: Level | None
    ros_port: int
    video_port: int
    shell_port: int | None
    settings: SettingsObject
    site: str | None
    driver: Annotated[DrivenBy, CLOSED] | UnsetType | None = UNSET
    stopped: Annotated[Stopped, CLOSED] | UnsetType | None = UNSET
    fingerprint: str | UnsetType | None = UNSET
    hostname: str | UnsetType | None = UNSET
    agent_version: str | UnsetType | None = UNSET
    join_address: str | UnsetType | None = UNSET
    joined_at: Timestamp | UnsetType | None = UNSET
    address: str | UnsetType | None = UNSET
    rotate_key: bool | UnsetType = UNSET


class RobotList(Struct):
    """Robots, by name."""

    robots: list[ShownRobot]


class NewRegistration(Struct, forbid_unknown_fields=True):
    """A robot to enrol, with its key.

    `signature`, needed with a join token: as in RobotJoin, with `-` in place of the token. A key that the token has
    admitted before is refused (token_used_up).
    """

    mac: Mac
    public_key: PublicKeyLine
    signature: Signature | UnsetType = UNSET
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


class SessionQuery(RobotQuery, frozen=True):
    """The size of the list."""

    limit: Limit | UnsetType = UNSET


class SessionList(Struct):
    """Sessions, newest first."""

    sessions: list[RecordedSession]


class ButtonList(Struct, forbid_unknown_fields=True):
    """The buttons of the drive page."""

    buttons: GivenButtons


class KeyChoice(Struct, forbid_unknown_fields=True):
    """The key that is meant; another key that came since is not affected."""

    fingerprint: Fingerprint


class PendingKeyList(Struct):
    """Keys that wait, oldest first."""

    pending: list[PendingKey]


class RejectedKeyList(Struct):
    """Rejected keys, newest first."""

    rejected_keys: list[RejectedKey]


@operation("GET", "/robots", "user")
def list_robots(caller: Caller) -> RobotList:
    """List the robots that the user may see, each with its driver and its stop."""
    control = seen_robots.control_of_all(caller.tx)
    return RobotList(
        [
            shown_robot(
                seen,
                control.get(seen.robot.id, seen_robots.FREE),
                for_admin=caller.user.is_admin,
            )
            for seen in seen_robots.list_seen(caller.tx, caller.user)
        ]
    )


@operation("GET", "/robots/<robot>", "user")
def show_robot(caller: Caller, robot: str) -> ShownRobot:
    """Get a robot that the user may see."""
    seen = seen_robots.require(caller.tx, caller.user, robot, "observe", "show")
    control = seen_robots.control_of(caller.tx, seen.robot.id)
    return shown_robot(seen, control, for_admin=caller.user.is_admin)


@operation("PUT", "/robots/<robot>", "enroller", problems=(409,))
def register_robot(
    caller: EnrolmentCaller, robot: str, body: NewRegistration
) -> tuple[RegisteredRobot, Literal[200, 201]]:
    """Enrol a robot with its key, as a playbook does.

    As an admin, or with a join token and the key's `signature` over MAC and key. Repeating the request changes nothing
    and uses no token up. 200: the robot was enrolled already, or its row took the key. To a join token it answers an
    enrolled robot under any name.
    """
    tx, admin = caller.tx, caller.credential.admin
    registration = Registration(
        name=robot,
        mac=body.mac,
        public_key=body.public_key,
        credential=caller.credential,
        signature=body.signature or None,
        hostname=body.hostname or None,
        agent_version=body.agent_version or None,
        allow_local_mac=context().join.allow_local_macs,
    )
    enrolled, is_new = robot_service.register(tx, caller.source, registration)
    seen = seen_robots.get_seen(tx, enrolled.name)
    addresses = cells.sort_for_join(seen.robot.id, cells.read(tx), region=seen.robot.region)
    ssh = ssh_of(context().join, addresses)
    # A join token admits robots; it may not see who drives them.
    control = seen_robots.control_of(tx, seen.robot.id) if admin else None
    members = structs.asdict(shown_robot(seen, control, for_admin=admin is not None))
    if admin is None:
        members["level"] = None
    return RegisteredRobot(**members, ssh=ssh), 201 if is_new else 200


@operation("PATCH", "/robots/<robot>", "admin", problems=(409,))
def change_robot(
    caller: Caller, robot: str, body: Annotated[RobotChanges, AT_LEAST_ONE]
) -> ShownRobot:
    """Change the given members, all or none."""
    return _describe(caller, _change(caller, robot, body))


@operation("DELETE", "/robots/<robot>", "admin")
def remove_robot(caller: Caller, robot: str) -> None:
    """Remove the robot with its grants and sessions, and end its connection."""
    robot_service.remove(caller.tx, caller.source, robot)


@operation("GET", "/robots/<robot>/sessions", "admin")
def list_sessions(caller: Caller, robot: str, query: SessionQuery) -> SessionList:
    """List the robot's connections, newest first."""
    robot_id = seen_robots.get_seen(caller.tx, robot).robot.id
    return SessionList(seen_robots.sessions_of(caller.tx, robot_id, query.limit or USUAL_LIMIT))


@operation("PUT", "/robots/<robot>/page", "manager", tag="robots")
def set_page(caller: Caller, robot: str, body: PageObject) -> PageSettings:
    """Set the robot's settings of the drive page; for its managers."""
    return robot_service.change_settings(
        caller.tx, caller.source, robot, lambda present: {**present, "page": body}, "page"
    ).page


@operation("PUT", "/robots/<robot>/buttons", "manager", tag="robots")
def set_buttons(caller: Caller, robot: str, body: ButtonList) -> ButtonList:
    """Set the buttons of the drive page; for the robot's managers."""
    new_buttons = msgspec.to_builtins(body.buttons)
    settings = robot_service.change_settings(
        caller.tx,
        caller.source,
        robot,
        lambda present: {**present, "buttons": new_buttons},
        "buttons",
    )
    buttons = [button.as_dict() for button in settings.buttons]
    return msgspec.convert({"buttons": buttons}, ButtonList)


def _change(caller: Caller, name: str, body: RobotChanges) -> str:
    """Apply the changes, the name last; return the robot's name afterwards."""
    tx, source = caller.tx, caller.source
    if any(change is not UNSET for change in (body.mac, body.shell, body.state, body.name)):
        # Before the row that the other changes lock: a join takes both in this order, too.
        robots.lock_enrolment(tx)
    if body.mac is not UNSET:
        allow_local_mac = context().join.allow_local_macs
        robot_service.set_mac(tx, source, name, body.mac, allow_local_mac=allow_local_mac)
    if body.settings is not UNSET:
        settings = body.settings
        robot_service.change_settings(tx, source, name, lambda _present: settings)
    if body.site is not UNSET:
        grants.place_robot(tx, source, name, body.site)
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


def shown_robot(seen: SeenRobot, control: ControlState | None, *, for_admin: bool) -> ShownRobot:
    """Return a robot as its caller may see it.

    `control` is None for a caller who may not see who drives and who stopped it.
    """
    robot = seen.robot
    return ShownRobot(
        name=robot.name,
        mac=robot.mac,
        state=robot.state,
        online=seen.online,
        since=seen.since,
        level=seen.level,
        ros_port=robot.ros_port,
        video_port=robot.video_port,
        shell_port=robot.shell_port,
        settings=robot.settings,
        site=robot.site,
        driver=control.driver if control else UNSET,
        stopped=control.stopped if control else UNSET,
        **(_for_admins(seen) if for_admin else {}),
    )


def _for_admins(seen: SeenRobot) -> dict[str, Any]:
    robot, report = seen.robot, seen.robot.report
    return {
        "fingerprint": robot.fingerprint,
        "hostname": report.hostname if report else None,
        "agent_version": seen.agent_version,
        "join_address": report.address if report else None,
        "joined_at": robot.joined_at,
        "address": seen.address,
        "rotate_key": robot.rotate_requested_at is not None,
    }


def _describe(caller: Caller, robot: str) -> ShownRobot:
    seen = seen_robots.get_seen(caller.tx, robot)
    return shown_robot(seen, seen_robots.control_of(caller.tx, seen.robot.id), for_admin=True)


@operation("POST", "/robots/<robot>/approve", "admin", problems=(409,))
def approve_key(caller: Caller, robot: str, body: KeyChoice) -> ShownRobot:
    """Approve a waiting key, and no other."""
    robot_service.approve(caller.tx, caller.source, robot, body.fingerprint)
    return _describe(caller, robot)


@operation("POST", "/robots/<robot>/reject", "admin", problems=(409,))
def reject_key(caller: Caller, robot: str, body: KeyChoice) -> None:
    """Reject a waiting key, and remember it."""
    robot_service.reject(caller.tx, caller.source, robot, body.fingerprint)


@operation("POST", "/robots/<robot>/rekey", "admin")
def rekey_robot(caller: Caller, robot: str) -> ShownRobot:
    """Forget the key and end the robot's connection; the next key waits for approval."""
    robot_service.rekey(caller.tx, caller.source, robot)
    return _describe(caller, robot)


@operation("POST", "/robots/<robot>/rotate-key", "admin", problems=(409,))
def rotate_key(caller: Caller, robot: str) -> ShownRobot:
    """Ask the robot's agent for a new key; the connection stays."""
    robot_service.rotate_key(caller.tx, caller.source, robot)
    return _describe(caller, robot)


@operation("POST", "/robots/<robot>/move-ports", "admin", problems=(409, 422))
def move_ports(caller: Caller, robot: str) -> ShownRobot:
    """Assign another free pair of ports; the robot reconnects."""
    robot_service.move_ports(caller.tx, caller.source, robot)
    return _describe(caller, robot)


@operation("GET", "/pending", "admin")
def list_pending(caller: Caller) -> PendingKeyList:
    """List keys that wait for approval."""
    return PendingKeyList(robots.list_waiting(caller.tx))


@operation("GET", "/rejected-keys", "admin")
def list_rejected_keys(caller: Caller) -> RejectedKeyList:
    """List rejected keys."""
    return RejectedKeyList(robots.list_rejected_keys(caller.tx))


@operation("DELETE", "/rejected-keys/<int:key_id>", "admin")
def forgive_key(caller: Caller, key_id: int) -> None:
    """Forget the rejection: the key may join again."""
    pending.forgive(caller.tx, caller.source, key_id)

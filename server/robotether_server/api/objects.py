"""Builds the API's robots from records, and where a tunnel goes. Pure, but for reading sshd's host keys.

What only admins may know of a robot stands in `_for_admins`, and nowhere else.
"""

from pathlib import Path
from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.db.control_states import ControlState, DrivenBy, Stopped
from robotether_server.db.grants import Level
from robotether_server.db.robots import SeenRobot, State
from robotether_server.field_types import RobotName, Timestamp
from robotether_server.problems import StoreUnavailable
from robotether_server.settings import JoinSettings

SSH_USER = "tunnel"
KEY_WORDS = 2
CLOSED = Meta(extra_json_schema={"additionalProperties": False})
# Described by this type; the service parses them.
SettingsObject = Annotated[
    dict[str, Any], Meta(extra_json_schema={"$ref": "#/components/schemas/GivenSettings"})
]


class ShownRobot(Struct, kw_only=True):
    """A robot, as the caller may see it.

    `since`: the last change of `online`, null if it was never seen. `level`: the user's, null for a join token.
    `shell_port` null: no shell. `driver` and `stopped` are the database's, null for nobody, and missing in the answer
    to a join token; /control and /events say whether the guard has confirmed a stop. Members after `stopped` are for
    admins only. `agent_version` and `address` are the newest session's, else the join's. `rotate_key`: the robot is
    asked for a new key.
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


class Ssh(Struct):
    """Where the robot's tunnel goes; `host` null: the host of this request. `host_keys`: TYPE BASE64, to be pinned."""

    user: str
    host: str | None
    ports: list[int]
    host_keys: list[str]


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


def ssh_of(settings: JoinSettings) -> Ssh:
    """Return where a robot's tunnel goes, and the keys that it pins; raise StoreUnavailable."""
    host_keys = read_host_keys(settings.ssh_host_keys_dir)
    return Ssh(SSH_USER, settings.public_host, list(settings.ssh_ports), host_keys)


def read_host_keys(folder: Path) -> list[str]:
    """Return each key as `TYPE BASE64`, by file name; raise StoreUnavailable when there is none."""
    lines = []
    for path in sorted(folder.glob("*.pub")):
        words = path.read_text(encoding="ascii").split()
        if len(words) >= KEY_WORDS:
            lines.append(" ".join(words[:KEY_WORDS]))
    if not lines:
        raise StoreUnavailable(
            f"cannot read sshd's host keys: {folder} has no *.pub file yet; try again shortly"
        )
    return lines

"""Builds the API's robots from records, and where a tunnel goes. Pure, but for reading sshd's host keys.

What only admins may know of a robot stands in `_for_admins`, and nowhere else.
"""

from pathlib import Path
from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.db.grants import Level
from robotether_server.db.robots import State
from robotether_server.db.seen_robots import ControlState, DrivenBy, SeenRobot, Stopped
from robotether_server.field_types import RobotName, Timestamp
from robotether_server.problems import StoreUnavailable
from robotether_server.settings import JoinSettings

SSH_USER = "tunnel"
KEY_WORDS = 2
CLOSED = Meta(extra_json_schema={"additionalProperties": False})
# Described by their type, and read by the service that takes them.
SettingsObject = Annotated[
    dict[str, Any], Meta(extra_json_schema={"$ref": "#/components/schemas/GivenSettings"})
]


class ShownRobot(Struct, kw_only=True):
    """A robot as an admin, or a user who may see it, may know it.

    `since`: the last change of `online`; null: never seen. `level`: what the user may; null: a join token asked.
    `shell_port` null: no shell. `driver` and `stopped`: who drives, and who stopped it, as the database has it; null:
    nobody; missing in the answer to a join token. Whether its guard has confirmed a stop is told by /control and
    /events. What follows `stopped` is for admins alone; `agent_version` and `address` are the newest session's, or else
    the join's, and `rotate_key` asks the robot to make a new key.
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
    """Where the robot's tunnel goes; `host` null: where this request went. `host_keys` are pinned, as TYPE BASE64."""

    user: str
    host: str | None
    ports: list[int]
    host_keys: list[str]


def shown_robot(seen: SeenRobot, control: ControlState | None, *, for_admin: bool) -> ShownRobot:
    """Return a robot as an admin, or a user who may see it, may know it.

    Without `control` it does not say who drives and who stopped it: who asks may not see that.
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

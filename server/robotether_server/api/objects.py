"""Builds the API's objects from records. Pure, but for reading sshd's host keys.

What only admins may know of a robot stands in `_for_admins`, and nowhere else.
"""

import datetime as dt
from collections.abc import Mapping
from pathlib import Path

from robotether_server.db.control_states import ControlState
from robotether_server.db.robots import SeenRobot
from robotether_server.problems import StoreUnavailable
from robotether_server.settings import JoinSettings
from robotether_server.times import rfc3339

Object = dict[str, object]
SSH_USER = "tunnel"


KEY_WORDS = 2


def plain(record: Mapping[str, object]) -> Object:
    """Return a record's fields as they are, moments as texts."""
    return {
        name: rfc3339(value) if isinstance(value, dt.datetime) else value
        for name, value in record.items()
    }


def robot_object(seen: SeenRobot, control: ControlState | None, *, for_admin: bool) -> Object:
    """Return a robot as an admin, or a user who may see it, may know it.

    Without `control` it does not say who drives and who stopped it: who asks may not see that.
    """
    robot = seen.robot
    known: Object = {
        "name": robot.name,
        "mac": robot.mac,
        "state": robot.state,
        "online": seen.online,
        "since": rfc3339(seen.since),
        "level": seen.level,
        "ros_port": robot.ros_port,
        "video_port": robot.video_port,
        "shell_port": robot.shell_port,
        "settings": robot.settings,
        "site": robot.site,
    }
    if control is not None:
        known |= _control(control)
    return known | _for_admins(seen) if for_admin else known


def _control(control: ControlState) -> Object:
    """Return the members of the relay's control object that the database knows, by the same names."""
    driver, stopped = control.driver, control.stopped
    return {
        "driver": plain(vars(driver)) if driver else None,
        "stopped": plain(vars(stopped)) if stopped else None,
    }


def _for_admins(seen: SeenRobot) -> Object:
    robot, report = seen.robot, seen.robot.report
    return {
        "fingerprint": robot.fingerprint,
        "hostname": report.hostname if report else None,
        "agent_version": seen.agent_version,
        "join_address": report.address if report else None,
        "joined_at": rfc3339(robot.joined_at),
        "address": seen.address,
        "rotate_key": robot.rotate_requested_at is not None,
    }


def ssh_object(settings: JoinSettings) -> Object:
    """Return where a robot's tunnel goes, and the keys that it pins; raise StoreUnavailable."""
    return {
        "user": SSH_USER,
        "host": settings.public_host,
        "ports": list(settings.ssh_ports),
        "host_keys": read_host_keys(settings.ssh_host_keys_dir),
    }


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

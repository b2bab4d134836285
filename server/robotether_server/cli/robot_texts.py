"""How the commands show a robot: as a record, a row or JSON."""

import json
from collections.abc import Mapping

from robotether_server.cli.common import timestamp
from robotether_server.db.robots import PendingKey, RobotRow
from robotether_server.db.seen_robots import RecordedSession, SeenRobot

HEADS = ("NAME", "STATE", "ONLINE", "SINCE", "MAC", "ROS", "VIDEO", "SHELL", "KEY")
WAITING_HEADS = ("ROBOT", "MAC", "HOST NAME", "ADDRESS", "JOINED", "WHY", "KEY")
SESSION_HEADS = ("STARTED", "ENDED", "BECAUSE", "ADDRESS", "AGENT")

Fields = list[tuple[str, str]]

NOT_JOINED = "not joined yet"
# Settings with a line of their own in the record.
OF_THEIR_OWN = ("region", "shell_user")


def identity(robot: RobotRow) -> Fields:
    """Return lines by which a person recognises the robot."""
    report = robot.report
    return [
        ("robot", f"{robot.name} ({robot.state})"),
        ("MAC", robot.mac),
        ("host name", report.hostname if report else NOT_JOINED),
        ("address", report.address if report else NOT_JOINED),
        ("joined", timestamp(robot.joined_at, NOT_JOINED)),
        ("key", robot.fingerprint or "none yet"),
    ]


def waiting_identity(key: PendingKey, robot: RobotRow) -> Fields:
    """Return lines about a waiting key; the last one is the key to compare."""
    fields = [
        ("robot", f"{robot.name} ({robot.state})"),
        ("MAC", key.mac),
        ("host name", key.hostname),
        ("address", key.address),
        ("joined", timestamp(key.joined_at, NOT_JOINED)),
    ]
    if key.reason == "mac_in_use":
        note = f"it has another key, {robot.fingerprint}, and keeps it; this one would replace it"
        fields.append(("beware", note))
    return [*fields, ("key", key.fingerprint)]


def everything(seen: SeenRobot) -> Fields:
    """Return the whole record."""
    robot = seen.robot
    online = "yes, since" if seen.online else "no, since"
    return [
        *identity(robot),
        ("online", f"{online} {timestamp(seen.since, '')}" if seen.since else "never seen"),
        ("last address", seen.address or "none yet"),
        ("agent", seen.agent_version or "unknown"),
        ("ports", f"ros {robot.ros_port}, video {robot.video_port}"),
        ("site", robot.site or "none"),
        ("region", robot.region or "none"),
        ("settings", _policy_words(robot.settings)),
        ("shell", f"on, port {robot.shell_port}" if robot.shell else "off"),
        ("shell user", str(robot.settings.get("shell_user", "not set"))),
        ("new key", "asked for" if robot.rotate_requested_at else "not asked for"),
    ]


def as_row(seen: SeenRobot) -> tuple[str, ...]:
    """Return a row under HEADS."""
    robot = seen.robot
    return (
        robot.name,
        robot.state,
        "yes" if seen.online else "no",
        timestamp(seen.since, "never"),
        robot.mac,
        str(robot.ros_port),
        str(robot.video_port),
        str(robot.shell_port or "off"),
        robot.fingerprint or "none yet",
    )


def as_waiting_row(key: PendingKey) -> tuple[str, ...]:
    """Return a row under WAITING_HEADS."""
    why = "MAC is in use" if key.reason == "mac_in_use" else "is new"
    joined = timestamp(key.joined_at, "")
    return (key.robot, key.mac, key.hostname, key.address, joined, why, key.fingerprint)


def as_session_row(session: RecordedSession) -> tuple[str, ...]:
    """Return a row under SESSION_HEADS."""
    ended = timestamp(session.ended_at, "ongoing")
    return (
        timestamp(session.started_at, ""),
        ended,
        session.end_code or "-",
        session.address,
        session.agent_version or "-",
    )


def as_dict(seen: SeenRobot) -> dict[str, object]:
    """Return what --json prints."""
    robot = seen.robot
    return {
        "name": robot.name,
        "mac": robot.mac,
        "state": robot.state,
        "online": seen.online,
        "since": seen.since,
        "ros_port": robot.ros_port,
        "video_port": robot.video_port,
        "shell_port": robot.shell_port,
        "settings": robot.settings,
        "site": robot.site,
        "fingerprint": robot.fingerprint,
        "joined_at": robot.joined_at,
        "address": seen.address,
        "agent_version": seen.agent_version,
        "rotate_key": robot.rotate_requested_at is not None,
    }


def _policy_words(settings: Mapping[str, object]) -> str:
    """Return what differs from the defaults, as JSON that the API takes."""
    values = {name: value for name, value in settings.items() if name not in OF_THEIR_OWN}
    return json.dumps(values) if values else "the defaults"

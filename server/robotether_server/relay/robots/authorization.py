"""Decides which connections of a robot are allowed, and what a changed row means for open ones.

`session_server` asks when a robot connects, `robot_link` when its row changed. Pure: no network, no
clock. What a login may listen on is fixed by sshd when it logs in, so that a port that is taken
away from a robot ends every connection that may still hold it.
"""

from __future__ import annotations

from robotether_common.services import BY_CONNECTION
from robotether_common.session import ByeCode, Kind

from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.problems import RobotetherError
from robotether_server.relay.robots.session_messages import Preface, config_of


class NotAuthorizedError(RobotetherError):
    """The robot may not connect, or stay; the agent is sent why."""

    code: ByeCode

    def __init__(self, code: ByeCode, detail: str) -> None:
        super().__init__(detail)
        self.code = code


def authorize(snapshot: Snapshot, preface: Preface) -> RelayRobot:
    """Return the robot's row; NotAuthorizedError when this connection may not be."""
    robot = snapshot.robots.get(preface.robot_id)
    if robot is None:
        raise NotAuthorizedError("robot_unknown", "this robot is no longer in the database")
    if robot.state != "active":
        raise NotAuthorizedError("robot_disabled", f"robot {robot.name} is {robot.state}")
    if preface.fingerprint not in (robot.fingerprint, robot.previous_fingerprint):
        raise NotAuthorizedError("key_changed", f"robot {robot.name} has another key by now")
    if preface.kind == "shell" and port_of("shell", robot) is None:
        raise NotAuthorizedError("shell_off", f"the shell of robot {robot.name} is off")
    # A robot may log in, wait while its port goes to another one, and only then show itself here.
    if not preface.ports <= set(robot.ports.values()):
        raise _ports_changed(robot)
    return robot


def needs_config(before: RelayRobot, after: RelayRobot) -> bool:
    """Return whether a live link needs another configuration; NotAuthorizedError when it needs a new login."""
    if _lost_port(before, after):
        raise _ports_changed(after)
    return config_of(before) != config_of(after)


def port_of(kind: Kind, robot: RelayRobot) -> int | None:
    """Return the port that a connection of this kind is there for."""
    return robot.ports[BY_CONNECTION[kind].name]


def _ports_changed(robot: RelayRobot) -> NotAuthorizedError:
    return NotAuthorizedError("ports_changed", f"robot {robot.name} has new ports; connect again")


def _lost_port(before: RelayRobot, after: RelayRobot) -> bool:
    # A first shell port takes nothing away: the agent opens another connection for it.
    return any(
        old is not None and old != new
        for old, new in zip(before.ports.values(), after.ports.values(), strict=True)
    )

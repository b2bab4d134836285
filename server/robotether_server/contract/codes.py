"""The codes of ended connections, drives, sessions and recordings and of rejected messages, each with its sentences.

The relay writes them; pages show them, and give them to their scripts. A code that is missing here is
shown as it is. `problems` has the codes of problems.
"""

from collections.abc import Mapping
from typing import NamedTuple

UNREADABLE = "It sent what the server cannot read: see the agent's log."
_SERVER_STOPPED = "The server stopped; the robot connects by itself."
_MOVING = "The robot is connecting again."


class CloseCode(NamedTuple):
    """The number with which the relay closes a WebSocket, and how a drive on it ended; None: it carries no drive.

    `status`: of HTTP, for a request that ends so before it is answered.
    """

    number: int
    drive: str | None = None
    status: int = 500


class SessionEnd(NamedTuple):
    """Why a robot's session ended, and what a card with room for some 58 characters says of it while it is offline."""

    why: str
    offline: str | None = None


CLOSE_CODES: Mapping[str, CloseCode] = {
    "client_left": CloseCode(1000, "driver left"),
    "control_given_up": CloseCode(4000, "gave up control"),
    "client_vanished": CloseCode(1006, "driver's connection lost"),
    "client_silent": CloseCode(4408, "driver's connection went silent"),
    "client_slow": CloseCode(4413, "driver's connection too slow"),
    "client_floods": CloseCode(1008, "driver's connection sent too much"),
    "superseded": CloseCode(4002, "continued in another window", 409),
    "rights_ended": CloseCode(4001, "permissions or settings changed", 403),
    "robot_stopped": CloseCode(4003, "robot stopped", 409),
    "lease_held": CloseCode(4009, "somebody else was driving", 409),
    "lease_lost": CloseCode(4010, "somebody else got control", 409),
    "lease_unavailable": CloseCode(4510, "database unavailable", 503),
    "too_many_connections": CloseCode(4429, "too many connections", 429),
    "robot_offline": CloseCode(4503, "robot offline", 503),
    "rosbridge_down": CloseCode(4504, "rosbridge did not answer", 502),
    "link_lost": CloseCode(4505, "link to the robot lost", 503),
    "message_too_big": CloseCode(1009, "message too large", 502),
    "protocol_broken": CloseCode(1002, "protocol error", 502),
    "relay_stopping": CloseCode(1001, "server shut down", 503),
    "relay_failed": CloseCode(1011, "server error"),
    "video_down": CloseCode(4506),
}
# How a drive ended. The last two are written for what a relay left open.
DRIVE_ENDS: Mapping[str, str] = {
    **{name: code.drive for name, code in CLOSE_CODES.items() if code.drive is not None},
    "relay_restarted": "server restarted",
    "cell_removed": "server machine lost",
}
# How a recording ended, or why it did not begin.
RECORDING_ENDS: Mapping[str, str] = {
    "stopped": "stopped by a person",
    "right_ended": "the person who asked may no longer drive the robot",
    "drive_ended": "the drive ended",
    "complete": "complete",
    "setting_changed": "the robot's setting changed",
    "robot_offline": "robot offline",
    "robot_moved": "the robot moved to another machine",
    "robot_gone": "robot disabled or removed",
    "robot_renamed": "robot renamed",
    "too_long": "maximum length reached",
    "disk_full": "disk full or not writable",
    "quota_reached": "no room left for recordings",
    "recorder_away": "the recorder was not running",
    "relay_away": "the recorder lost the relay",
    "recorder_stopped": "the recorder stopped",
    "recorder_restarted": "the recorder was killed",
    "cell_removed": "server machine lost",
}
SESSION_ENDS: Mapping[str, SessionEnd] = {
    "superseded": SessionEnd("a newer session took over", _MOVING),
    "robot_disabled": SessionEnd(
        "the robot was disabled", "It was disabled; it connects by itself within minutes."
    ),
    "robot_unknown": SessionEnd(
        "the robot was removed", "It had been removed from this server; it must join again."
    ),
    "ports_changed": SessionEnd("its ports changed", _MOVING),
    "port_taken": SessionEnd(
        "another connection held its port",
        "An older connection had its port; it connects by itself.",
    ),
    "key_changed": SessionEnd("its key changed", "It used a key that is no longer its own."),
    "shell_off": SessionEnd("its shell was turned off"),
    "not_ready": SessionEnd(
        "the server was not ready", "The server was not ready; it connects by itself."
    ),
    "relay_stopping": SessionEnd("the server stopped", _SERVER_STOPPED),
    "relay_restarted": SessionEnd("the server restarted", _SERVER_STOPPED),
    "cell_draining": SessionEnd("its server's machine was taken out of service", _MOVING),
    "rebalanced": SessionEnd("it was sent to a machine of the server with fewer robots", _MOVING),
    "cell_removed": SessionEnd(
        "its server's machine was lost", "Its server's machine was lost; it moves to another."
    ),
    "protocol_error": SessionEnd("it sent what the server could not read", UNREADABLE),
    "timeout": SessionEnd(
        "nothing came from the robot, or it took nothing",
        "The robot went silent: perhaps no power or network.",
    ),
    "unwatched": SessionEnd("nobody watched its video"),
    "link_lost": SessionEnd(
        "its connection ended", "The tunnel was closed, perhaps by power, agent or network."
    ),
}
# They follow on a number of messages. Kinds of the relay's policy, and those of the guard on the robot (guard_).
REFUSALS: Mapping[str, str] = {
    "topic": "to a topic that is not allowed",
    "service": "to a service that is not allowed",
    "operation": "of an operation that is not allowed",
    "shape": "with fields that are not allowed",
    "rate": "over the rate",
    "size": "too large",
    "subscriptions": "over the number of subscriptions",
    "json": "not readable",
    "guard_old": "too old at the robot",
    "guard_fence": "of another driver at the robot",
    "guard_stopped": "while the robot was stopped",
    "guard_shape": "not understood by the robot's guard",
    "guard_held": "while the robot could not accept them",
}

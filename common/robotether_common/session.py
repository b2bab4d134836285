"""The session's lines (docs/reference/protocols.md, "The session") as agent and relay know them.

Each reads the other's lines by itself, and says in its own words what is wrong with one. Data only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

MAX_LINE_BYTES = 64 * 1024
# Maximum fence; the database counts them in a signed integer of 64 bits.
MAX_FENCE = 2**63 - 1
# Maximum epoch of a session, in ms; each is greater than the one before.
MAX_EPOCH = 2**53

# What a robot's SSH connection is for.
Kind = Literal["session", "media", "shell"]
ServiceState = Literal["ok", "down", "unknown"]
# What asked for help: a program on the robot, or one of the rules in its settings.
HelpSource = Literal["robot", "stop", "battery", "diagnostics", "geofence", "navigation"]
# Maximum length of the reason of a call for help, and the lowest of its priorities; 1 is the most urgent.
MAX_HELP_REASON, LOWEST_PRIORITY = 200, 3
GuardState = Literal["ready", "down"]
# Why a connection ended, as the agent reads it in `bye`.
ByeCode = Literal[
    "superseded",  # a newer connection of this robot and kind took over
    "robot_disabled",
    "robot_unknown",
    "ports_changed",  # they are not the robot's: log in again, as sshd fixes ports at the log-in
    "port_taken",  # another SSH connection holds it: connect again; sshd drops a dead one within 15 s
    "key_changed",  # it is neither the robot's key nor the one before its rotation
    "shell_off",
    "unwatched",  # nobody watches any more: the media connection opens again for the next viewer
    "cell_draining",  # the machine is taken out of service: connect to the next
    "rebalanced",  # another machine has fewer robots: connect to the next
    "not_ready",  # the relay has not read the database yet
    "relay_stopping",
    "protocol_error",
    "timeout",
    "link_lost",  # never sent: the connection just ended
]


@dataclass(frozen=True)
class Battery:
    """How full a robot's battery is, in percent (None: unknown), and whether it is being charged."""

    percent: int | None
    charging: bool


@dataclass(frozen=True)
class HelpCall:
    """A robot asks for a person. `priority` is from 1 (urgent) to 3."""

    source: HelpSource
    reason: str
    priority: int = 2

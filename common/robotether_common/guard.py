"""What the relay and a robot's guard agree on: the handshake, the stamp of a drive command, and the guard's settings.

Each checks what the other sends by itself: the guard is the second check.
"""

from __future__ import annotations

from typing import Literal, get_args

# Headers of the relay's WebSocket to rosbridge, and the HTTP status for whose lease is not in force, or whose number
# the robot's disk does not take.
KEY_HEADER = "Robotether-Key"
MODE_HEADER = "Robotether-Mode"
FENCE_HEADER = "Robotether-Fence"
FENCE_REFUSED = 409
DISK_REFUSED = 507
# Header in which guard, topics and frames service say why they refuse a WebSocket, for people.
REASON_HEADER = "Robotether-Reason"
# The member beside `msg` in a drive command, with `t_ms` and `fence`, and `seen` of a client that names frames.
STAMP = "robotether"
# Maximum number of frames that one command names, of as many cameras.
MAX_SEEN_FRAMES = 8
# Time for which agent and relay remember a frame, and the age from which it counts as unknown.
MAX_SEEN_S = 10.0
# Maximum number of frames of one camera that each of them remembers, some more than come at 60 a second.
MAX_FRAMES = 1000
# Maximum time in one report for which commands were slowed; reports go out each half second.
MAX_SLOWED_S = 3600.0

DEFAULT_TOPICS = ("/cmd_vel", "*/cmd_vel")
# Default limit, in ms, of the deadman and of a command's age: a robot can stop within it.
DEFAULT_MS = 500
TIMES_MS = (200, 2000)

# Maximum magnitude of a number in a drive command; beyond 3e38 a float32 of ROS is infinite.
MAX_NUMBER = 1e9

# old: its age; fence: another one's lease; stopped: the latch; shape: what it says; held: nobody may drive now.
RefusedKind = Literal["old", "fence", "stopped", "shape", "held"]
REFUSED_KINDS: tuple[RefusedKind, ...] = get_args(RefusedKind)

# Why a guard stopped a robot that moved. silence: no further command came; lost: its driver's connection, lease or
# session ended; fault: rosbridge, the agent or the guard did not answer; person: somebody stopped the robot.
StopCause = Literal["silence", "lost", "fault", "person"]
STOP_CAUSES: tuple[StopCause, ...] = get_args(StopCause)


def count_values(message: bytes) -> int:
    """Return about how many values a message in JSON has: reading it takes time by them, not by its bytes alone."""
    return message.count(b",") + message.count(b"{") + message.count(b"[")

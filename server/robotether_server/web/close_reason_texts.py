"""Why a drive or a robot's session ended, in words for a table's cell. Pure.

A code that is not here is shown as it is, as all are in the API and in the files for programs.
"""

from collections.abc import Mapping

# They follow on "ended by". The codes are those of docs/protocols.md, and one that a new relay writes
# for what the relay before it left open.
DRIVES: Mapping[str, str] = {
    "client_left": "the driver",
    "client_vanished": "loss of the driver's connection",
    "client_silent": "silence of the driver's connection",
    "client_slow": "a driver's connection that was too slow",
    "client_floods": "a driver's connection that sent too much",
    "superseded": "a newer connection of the driver",
    "rights_ended": "a change of rights or settings",
    "robot_stopped": "a stop of the robot",
    "lease_held": "somebody else, who drove already",
    "lease_lost": "a change of driver",
    "lease_unavailable": "a database without answer",
    "too_many_connections": "too many connections",
    "robot_offline": "the robot, which was offline",
    "rosbridge_down": "a rosbridge without answer",
    "link_lost": "loss of the link to the robot",
    "message_too_big": "a message that was too big",
    "protocol_broken": "a breach of the WebSocket protocol",
    "relay_stopping": "a shutdown of the server",
    "relay_restarted": "a restart of the server",
    "relay_failed": "a defect of the server",
}

SESSIONS: Mapping[str, str] = {
    "superseded": "a newer session took over",
    "robot_disabled": "the robot was disabled",
    "robot_unknown": "the robot was removed",
    "ports_changed": "its ports changed",
    "port_taken": "another connection held its port",
    "key_changed": "its key changed",
    "shell_off": "its shell was turned off",
    "not_ready": "the server was not ready",
    "relay_stopping": "the server stopped",
    "relay_restarted": "the server restarted",
    "protocol_error": "it sent what the server could not read",
    "timeout": "nothing came from the robot, or it took nothing",
    "link_lost": "its connection ended",
}


def drive_end(code: str) -> str:
    """Return what ended a drive."""
    return DRIVES.get(code, code)


def session_end(code: str) -> str:
    """Return why a robot's session ended."""
    return SESSIONS.get(code, code)

"""Says why a robot is offline, for the fleet page, the drive page and the admin pages. Pure."""

import re
from collections.abc import Mapping

from robotether_server import __version__

_SERVER_STOPPED = "The server stopped; the robot connects by itself."
_UNREADABLE = "It sent what the server cannot read: see the agent's log."
_MOVING = "The robot is connecting again."
# A card has room for some 58 characters. By why its last session ended: a code of docs/reference/protocols.md.
_BY_END: Mapping[str, str] = {
    "link_lost": "The tunnel was closed, perhaps by power, agent or network.",
    "timeout": "The robot went silent: perhaps no power or network.",
    "protocol_error": _UNREADABLE,
    "key_changed": "It used a key that is no longer its own.",
    "robot_disabled": "It was disabled; it connects by itself within minutes.",
    "robot_unknown": "It had been removed from this server; it must join again.",
    "relay_stopping": _SERVER_STOPPED,
    "relay_restarted": _SERVER_STOPPED,
    "cell_removed": "Its server's machine was lost; it moves to another.",
    "not_ready": "The server was not ready; it connects by itself.",
    "port_taken": "An older connection had its port; it connects by itself.",
    "superseded": _MOVING,
    "ports_changed": _MOVING,
    "cell_draining": _MOVING,
    "rebalanced": _MOVING,
}
_BY_KEY: Mapping[str, str] = {
    "waiting": "Another key with its MAC awaits approval.",
    "rejected": "Another key with its MAC was rejected.",
}


def offline_reason(
    state: str,
    end_code: str | None,
    *,
    ever_online: bool,
    other_key: str | None = None,
    agent_version: str | None = None,
) -> str:
    """Say why a robot is offline.

    `end_code` is its last session's, None if unknown. `other_key`: whether a key that is not
    its own is `waiting` or `rejected`; that may be the reason, or not. It is `host_key` if the robot
    has said that it refuses the server's.
    """
    if state == "disabled":
        return "An administrator disabled this robot."
    if state == "pending":
        return "This robot awaits approval."
    if other_key == "host_key":
        return "It refuses this server's SSH host key: see Add a robot."
    never = "This robot has not connected yet."
    ended = _BY_END.get(end_code or "", "It is not known why.") if ever_online else never
    if ended == _UNREADABLE:
        ended = _unreadable(agent_version)
    return f"{_BY_KEY[other_key]} {ended}" if other_key else ended


def _unreadable(agent_version: str | None) -> str:
    """Say why the server cannot read an agent, by its version, which is what it has said itself."""
    theirs, ours = _numbers(agent_version or ""), _numbers(__version__)
    if theirs and theirs < ours:
        return f"Its agent {agent_version} is too old for this server: upgrade it."
    if theirs > ours:
        return f"Its agent {agent_version} is newer than this server, {__version__}."
    return _UNREADABLE


def _numbers(version: str) -> tuple[int, ...]:
    match = re.match(r"\d{1,6}(?:\.\d{1,6}){0,3}", version)
    return tuple(map(int, match[0].split("."))) if match else ()

"""Says why a robot is offline, for the fleet page, the drive page and the admin pages. Pure."""

import re
from collections.abc import Mapping

from robotether_server import __version__
from robotether_server.contract.codes import SESSION_ENDS, UNREADABLE

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
    ended = _ended(end_code, agent_version) if ever_online else "This robot has not connected yet."
    return f"{_BY_KEY[other_key]} {ended}" if other_key else ended


def _ended(end_code: str | None, agent_version: str | None) -> str:
    session_end = SESSION_ENDS.get(end_code or "")
    why = session_end.offline if session_end else None
    return _unreadable(agent_version) if why == UNREADABLE else why or "It is not known why."


def _unreadable(agent_version: str | None) -> str:
    """Say why the server cannot read an agent, by its version, which is what it has said itself."""
    theirs, ours = _numbers(agent_version or ""), _numbers(__version__)
    if theirs and theirs < ours:
        return f"Its agent {agent_version} is too old for this server: upgrade it."
    if theirs > ours:
        return f"Its agent {agent_version} is newer than this server, {__version__}."
    return UNREADABLE


def _numbers(version: str) -> tuple[int, ...]:
    match = re.match(r"\d{1,6}(?:\.\d{1,6}){0,3}", version)
    return tuple(map(int, match[0].split("."))) if match else ()

"""Says why a robot is offline, for the fleet page, the drive page and the admin pages. Pure."""

from collections.abc import Mapping

_SERVER_STOPPED = "The server stopped; the robot connects by itself."
_MOVING = "The robot is connecting again."
# A card has room for some 58 characters. By why its last session ended: a code of docs/reference/protocols.md.
_BY_END: Mapping[str, str] = {
    "link_lost": "The tunnel was closed, perhaps by power, agent or network.",
    "timeout": "The robot went silent: perhaps no power or network.",
    "protocol_error": "It sent what the server cannot read: agent too old?",
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
    state: str, end_code: str | None, *, ever_online: bool, other_key: str | None = None
) -> str:
    """Say why a robot is offline.

    `end_code` is its last session's, None if unknown. `other_key`: whether a key that is not
    its own is `waiting` or `rejected`; that may be the reason, or not.
    """
    if state == "disabled":
        return "An administrator disabled this robot."
    if state == "pending":
        return "This robot awaits approval."
    never = "This robot has not connected yet."
    ended = _BY_END.get(end_code or "", "It is not known why.") if ever_online else never
    return f"{_BY_KEY[other_key]} {ended}" if other_key else ended

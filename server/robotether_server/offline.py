"""Says why a robot is offline, for the fleet page, the drive page and the admin pages. Pure."""

from collections.abc import Mapping

_SERVER_STOPPED = "The server stopped while the robot was connected; the robot connects by itself."
_MOVING = "The robot is connecting again."
# By why its last session ended: a code of docs/reference/protocols.md.
_BY_END: Mapping[str, str] = {
    "link_lost": "The tunnel was closed: the robot shut down, its agent stopped, or its network changed.",
    "timeout": "The robot went silent: it has no power or no network, or its network is too slow.",
    "protocol_error": "The robot's agent speaks another version than this server: upgrade the agent.",
    "key_changed": "The robot used a key that is no longer its own. Compare the keys on its admin page.",
    "robot_disabled": "The robot was disabled; it connects again by itself within minutes.",
    "robot_unknown": "The robot had been removed from this server. It has to join again.",
    "relay_stopping": _SERVER_STOPPED,
    "relay_restarted": _SERVER_STOPPED,
    "cell_removed": "The server's machine that had the robot was lost; the robot connects to another.",
    "not_ready": "The server was not ready; the robot connects again by itself.",
    "port_taken": "An older connection held the robot's port; the robot connects again by itself.",
    "superseded": _MOVING,
    "ports_changed": _MOVING,
    "cell_draining": _MOVING,
    "rebalanced": _MOVING,
}
_BY_KEY: Mapping[str, str] = {
    "waiting": "A machine with its MAC shows another key, which awaits approval.",
    "rejected": "A machine with its MAC shows another key, which was rejected.",
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

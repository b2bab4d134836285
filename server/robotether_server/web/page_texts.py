"""Texts for the templates: times, keys, states, close reasons, refusals and audit lines. Pure.

A code or kind that is not here is shown as it is, as all are in the API and in the files for programs.
"""

import datetime as dt
from collections.abc import Mapping

from flask import Flask
from markupsafe import Markup

from robotether_server.db.audit import AuditEvent
from robotether_server.db.robots import RobotRow
from robotether_server.times import rfc3339

KEY_GROUP = 4
UNITS = ("B", "kB", "MB", "GB")
KILO = 1000


# They follow on a number of messages. Kinds of the relay's policy, and those of the guard on the robot (guard_).
KINDS: Mapping[str, str] = {
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
# How a drive ended. The codes are those of docs/reference/protocols.md, and one that a new relay writes for what the
# relay before it left open.
DRIVES: Mapping[str, str] = {
    "client_left": "driver left",
    "control_given_up": "gave up control",
    "client_vanished": "driver's connection lost",
    "client_silent": "driver's connection went silent",
    "client_slow": "driver's connection too slow",
    "client_floods": "driver's connection sent too much",
    "superseded": "continued in another window",
    "rights_ended": "permissions or settings changed",
    "robot_stopped": "robot stopped",
    "lease_held": "somebody else was driving",
    "lease_lost": "somebody else got control",
    "lease_unavailable": "database unavailable",
    "too_many_connections": "too many connections",
    "robot_offline": "robot offline",
    "rosbridge_down": "rosbridge did not answer",
    "link_lost": "link to the robot lost",
    "message_too_big": "message too large",
    "protocol_broken": "protocol error",
    "relay_stopping": "server shut down",
    "relay_restarted": "server restarted",
    "cell_removed": "server machine lost",
    "relay_failed": "server error",
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
    "cell_draining": "its server's machine was taken out of service",
    "rebalanced": "it was sent to a machine of the server with fewer robots",
    "cell_removed": "its server's machine was lost",
    "protocol_error": "it sent what the server could not read",
    "timeout": "nothing came from the robot, or it took nothing",
    "unwatched": "nobody watched its video",
    "link_lost": "its connection ended",
}
# Each kind's name in the filter, and what its line says after who did it. {robot} is the line's robot; the others are
# its details, `?` where one is missing. A sentence that needs more than that is in _BY_DETAILS.
EVENTS: Mapping[str, tuple[str, str]] = {
    "login": ("Log-in", "logged in"),
    "login_failed": ("Log-in failed", "failed to log in"),
    "logout": ("Log-out", "logged out"),
    "logins_ended": ("Log-out everywhere", "logged {user} out everywhere"),
    "password_set": ("Password set", "set a new password for {user}"),
    "user_added": ("User added", "added {role} {user}"),
    "user_removed": ("User removed", "removed {role} {user}"),
    "user_disabled": ("User disabled", "disabled user {user}"),
    "user_enabled": ("User enabled", "enabled user {user}"),
    "user_role_set": ("User's role changed", "changed the role of {user} from {was} to {role}"),
    "group_added": ("Group added", "added group {group}"),
    "group_removed": ("Group removed", "removed group {group}"),
    "group_member_added": ("Group member added", "added {user} to group {group}"),
    "group_member_removed": ("Group member removed", "removed {user} from group {group}"),
    "grant_given": ("Grant given", ""),
    "grant_taken": ("Grant removed", ""),
    "site_added": ("Site added", "added site {site}"),
    "site_removed": ("Site removed", "removed site {site}"),
    "cell_drained": ("Machine out of service", "took cell {cell} out of service"),
    "cell_resumed": ("Machine in service again", "put cell {cell} back into service"),
    "cell_removed": ("Machine removed", "removed cell {cell}"),
    "token_created": ("API token created", "created API token {token}"),
    "token_deleted": ("API token deleted", "deleted API token {token}"),
    "join_token_created": ("Join token created", "created join token {token}"),
    "join_token_deleted": ("Join token deleted", "deleted join token {token}"),
    "ssh_key_added": ("SSH key added", "added an SSH key"),
    "ssh_key_deleted": ("SSH key deleted", "deleted an SSH key"),
    "robot_added": ("Robot announced", "announced {robot}"),
    "robot_pending": ("Robot joined", "{robot} joined and waits for approval"),
    "robot_approved": ("Robot approved", "approved {robot}"),
    "robot_disabled": ("Robot disabled", "disabled {robot}"),
    "robot_enabled": ("Robot enabled", "enabled {robot}"),
    "robot_removed": ("Robot removed", "removed {robot}"),
    "robot_renamed": ("Robot renamed", "renamed {was} to {robot}"),
    "robot_mac_set": ("Robot's MAC changed", "changed the MAC of {robot} from {was} to {mac}"),
    "robot_ports_moved": ("Robot's ports changed", "changed the ports of {robot}"),
    "robot_rekeyed": ("Robot's key forgotten", "forgot the key of {robot}"),
    "robot_rotation_requested": ("Robot's new key requested", "asked {robot} for a new key"),
    "robot_settings_set": ("Robot's settings changed", "changed the settings of {robot}"),
    "robot_page_set": ("Robot's drive page changed", "changed the drive page of {robot}"),
    "robot_buttons_set": ("Robot's buttons changed", "changed the buttons of {robot}"),
    "robot_site_set": ("Robot's site changed", ""),
    "robot_shell_set": ("Robot's shell turned on or off", ""),
    "key_rejected": ("Key rejected", "rejected a key that claimed to be {robot}"),
    "key_forgiven": ("Key allowed again", "allowed a rejected key to ask again"),
    "key_refused": ("Key refused", "refused an unknown key"),
    "key_rotated": ("Key changed", "{robot} changed its key"),
    "key_claimed": ("Key claimed", "another machine claims to be {robot}"),
    "key_released": ("Key released", "released the key of {robot} for another robot"),
    "mac_changed": ("MAC differs", "{robot} joined with its key from another MAC"),
    "drive_started": ("Drive started", "started driving {robot}"),
    "drive_ended": ("Drive ended", ""),
    "lease_asked": ("Control asked for", "asked for control of {robot}"),
    "lease_refused": ("Control refused", "refused {to} control of {robot}"),
    "lease_handed_over": ("Control handed over", "handed control of {robot} to {to}"),
    "lease_passed": ("Control passed on", "got control of {robot}, because {driver} did not reply"),
    "lease_taken": ("Control taken", "took control of {robot} from {driver}"),
    "robot_stopped": ("Robot stopped", "stopped {robot}"),
    "robot_released": ("Robot released", "released {robot} after a stop"),
    "operations_refused": ("Messages blocked", ""),
}


def register(app: Flask) -> None:
    """Give the templates their filters."""
    app.add_template_filter(timestamp_words, "timestamp")
    app.add_template_filter(time_element, "time")
    app.add_template_filter(end_value, "end_value")
    app.add_template_filter(rfc3339, "rfc3339")
    app.add_template_filter(sentence, "sentence")
    app.add_template_filter(drive_end, "drive_end")
    app.add_template_filter(duration_words, "duration")
    app.add_template_filter(session_end, "session_end")
    app.add_template_filter(refusal)
    app.add_template_filter(key_groups, "key_groups")
    app.add_template_filter(state_words, "state_words")
    app.add_template_filter(size_words, "size")


def timestamp_words(timestamp: dt.datetime) -> str:
    """Return a time as a page without scripts shows it: 2026-01-01 12:03:59 UTC."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def time_element(timestamp: dt.datetime) -> Markup:
    """Return a time as markup: in the reader's own zone by src/pages/desk.js, in UTC on hover and without scripts."""
    words = timestamp_words(timestamp)
    return Markup('<time datetime="{}" title="{}">{}</time>').format(
        timestamp.isoformat(), words, words
    )


def duration_words(seconds: float) -> str:
    """Return a duration as people read it: 8 s, 1 min 35 s, 2 h 5 min; a clock that was set back gives 0 s."""
    minutes, rest = divmod(max(0, round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def end_value(timestamp: dt.datetime | None) -> str:
    """Return an end as a field of time has it: in UTC, to the minute, without its zone."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M") if timestamp else ""


def key_groups(fingerprint: str) -> list[str]:
    """Split a fingerprint in groups that the eye can compare; together they are the fingerprint."""
    kind, colon, digest = fingerprint.rpartition(":")
    groups = [digest[at : at + KEY_GROUP] for at in range(0, len(digest), KEY_GROUP)]
    return [kind + colon, *groups] if kind else groups


def state_words(robot: RobotRow) -> str:
    """Return a robot's state in a word or two."""
    if robot.state != "pending":
        return robot.state.capitalize()
    return "Awaiting approval" if robot.fingerprint else "Announced"


def size_words(count: int) -> str:
    """Return a number of bytes as people read it: 512 B, 181.2 MB."""
    value, unit = float(count), 0
    # What would be written as 1000.0 goes on to the next unit.
    while round(value, 1) >= KILO and unit < len(UNITS) - 1:
        value, unit = value / KILO, unit + 1
    return f"{value:.1f} {UNITS[unit]}" if unit else f"{count} B"


def refusal(kind: str) -> str:
    """Return what is said of the messages that were refused for this."""
    return KINDS.get(kind, kind)


def drive_end(code: str) -> str:
    """Return how a drive ended."""
    return DRIVES.get(code, code)


def session_end(code: str) -> str:
    """Return why a robot's session ended."""
    return SESSIONS.get(code, code)


class _Known(dict[str, object]):
    def __missing__(self, name: str) -> str:
        return "?"


def sentence(event: AuditEvent) -> str:
    """Return what the line says after who did it; a kind that is not known stays as it is."""
    if event.kind in _BY_DETAILS:
        return _BY_DETAILS[event.kind](event)
    if event.kind not in EVENTS:
        return event.kind
    details = _Known(event.details)
    details["robot"] = event.robot or "?"
    return EVENTS[event.kind][1].format_map(details)


def event_names() -> list[tuple[str, str]]:
    """Return each kind of event with its name, by name."""
    return sorted(((kind, name) for kind, (name, _) in EVENTS.items()), key=lambda pair: pair[1])


def _given(event: AuditEvent) -> str:
    return f"gave {_holder(event)} the right to {event.details.get('level', '?')} {_scope(event)}"


def _taken(event: AuditEvent) -> str:
    return (
        f"took from {_holder(event)} the right to {event.details.get('level', '?')} {_scope(event)}"
    )


def _placed(event: AuditEvent) -> str:
    site = event.details.get("site")
    if site is None:
        return f"removed {event.robot} from its site"
    return f"moved {event.robot} to site {site}"


def _shell(event: AuditEvent) -> str:
    return f"turned the shell of {event.robot} {'on' if event.details.get('shell') else 'off'}"


def _drive_ended(event: AuditEvent) -> str:
    lasted, code = event.details.get("lasted_s"), event.details.get("end_code")
    after = "" if lasted is None else f" after {duration_words(lasted)}"
    return f"stopped driving {event.robot}{after}" + (f" ({drive_end(code)})" if code else "")


def _blocked(event: AuditEvent) -> str:
    count = sum(event.details.values())
    return f"sent {event.robot} what is not allowed: {count} {'message' if count == 1 else 'messages'} blocked"


def _holder(event: AuditEvent) -> str:
    group = event.details.get("group")
    return f"{event.details.get('user', '?')}" if group is None else f"group {group}"


def _scope(event: AuditEvent) -> str:
    if event.details.get("all"):
        return "all robots"
    site = event.details.get("site")
    return f"{event.robot}" if site is None else f"site {site}"


_BY_DETAILS = {
    "grant_given": _given,
    "grant_taken": _taken,
    "robot_site_set": _placed,
    "robot_shell_set": _shell,
    "drive_ended": _drive_ended,
    "operations_refused": _blocked,
}

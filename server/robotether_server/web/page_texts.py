"""Texts for the templates: times, keys, states, close reasons, refusals and audit lines. Pure.

A code or kind that is not here is shown as it is, as all are in the API and in the files for programs.
"""

import datetime as dt
from collections.abc import Mapping

from flask import Flask

from robotether_server.db.audit import AuditEvent
from robotether_server.db.robots import Robot
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
# They follow on "ended by". The codes are those of docs/reference/protocols.md, and one that a new relay writes
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
    "lease_unavailable": "a database that did not answer",
    "too_many_connections": "too many connections",
    "robot_offline": "the robot, which was offline",
    "rosbridge_down": "a rosbridge that did not answer",
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
# {robot} is the line's robot; the others are its details, `?` where one is missing.
SENTENCES: Mapping[str, str] = {
    "login": "logged in",
    "login_failed": "failed to log in",
    "logout": "logged out",
    "logins_ended": "logged {user} out everywhere",
    "password_set": "set a new password for {user}",
    "user_added": "added {role} {user}",
    "user_removed": "removed {role} {user}",
    "user_disabled": "disabled user {user}",
    "user_enabled": "enabled user {user}",
    "user_role_set": "changed the role of {user} from {was} to {role}",
    "group_added": "added group {group}",
    "group_removed": "removed group {group}",
    "group_member_added": "added {user} to group {group}",
    "group_member_removed": "removed {user} from group {group}",
    "site_added": "added site {site}",
    "site_removed": "removed site {site}",
    "token_created": "created API token {token}",
    "token_deleted": "deleted API token {token}",
    "join_token_created": "created join token {token}",
    "join_token_deleted": "deleted join token {token}",
    "ssh_key_added": "added an SSH key",
    "ssh_key_deleted": "deleted an SSH key",
    "robot_added": "announced {robot}",
    "robot_pending": "{robot} joined and waits for approval",
    "robot_approved": "approved {robot}",
    "robot_disabled": "disabled {robot}",
    "robot_enabled": "enabled {robot}",
    "robot_removed": "removed {robot}",
    "robot_renamed": "renamed {was} to {robot}",
    "robot_mac_set": "changed the MAC of {robot}",
    "robot_ports_moved": "changed the ports of {robot}",
    "robot_rekeyed": "forgot the key of {robot}",
    "robot_rotation_requested": "asked {robot} for a new key",
    "robot_settings_set": "changed the policy, guard or shell user of {robot}",
    "robot_page_set": "changed the drive page of {robot}",
    "robot_buttons_set": "changed the buttons of {robot}",
    "key_rejected": "rejected a key that claimed to be {robot}",
    "key_forgiven": "allowed a rejected key to ask again",
    "key_refused": "refused an unknown key",
    "key_rotated": "{robot} changed its key",
    "key_claimed": "another machine claims to be {robot}",
    "drive_started": "started to drive {robot}",
    "drive_ended": "no longer drives {robot}",
    "lease_asked": "asked for control of {robot}",
    "lease_refused": "refused {to} control of {robot}",
    "lease_handed_over": "handed control of {robot} over to {to}",
    "lease_passed": "got control of {robot}, because {driver} did not reply",
    "lease_taken": "took control of {robot} from {driver}",
    "robot_stopped": "stopped {robot}",
    "robot_released": "released {robot} after a stop",
    "operations_refused": "sent messages that the policy of {robot} refused",
}


def register(app: Flask) -> None:
    """Give the templates their filters."""
    app.add_template_filter(timestamp_words, "timestamp")
    app.add_template_filter(end_value, "end_value")
    app.add_template_filter(rfc3339, "rfc3339")
    app.add_template_filter(sentence, "sentence")
    app.add_template_filter(drive_end, "drive_end")
    app.add_template_filter(session_end, "session_end")
    app.add_template_filter(refusal)
    app.add_template_filter(key_groups, "key_groups")
    app.add_template_filter(state_words, "state_words")
    app.add_template_filter(size_words, "size")


def timestamp_words(timestamp: dt.datetime) -> str:
    """Return a time as people read it: 2026-01-01 12:03 UTC."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%d %H:%M UTC")


def end_value(timestamp: dt.datetime | None) -> str:
    """Return an end as a field of time has it: in UTC, to the minute, without its zone."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M") if timestamp else ""


def key_groups(fingerprint: str) -> list[str]:
    """Split a fingerprint in groups that the eye can compare; together they are the fingerprint."""
    kind, colon, digest = fingerprint.rpartition(":")
    groups = [digest[at : at + KEY_GROUP] for at in range(0, len(digest), KEY_GROUP)]
    return [kind + colon, *groups] if kind else groups


def state_words(robot: Robot) -> str:
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
    """Return what ended a drive."""
    return DRIVES.get(code, code)


def session_end(code: str) -> str:
    """Return why a robot's session ended."""
    return SESSIONS.get(code, code)


class _Known(dict[str, object]):
    def __missing__(self, name: str) -> str:
        return "?"


def sentence(event: AuditEvent) -> str:
    """Return the text of the line, empty for a kind without one."""
    if event.kind in _BY_DETAILS:
        return _BY_DETAILS[event.kind](event)
    known = _Known(event.details)
    known["robot"] = event.robot or "?"
    return SENTENCES.get(event.kind, "").format_map(known)


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
}

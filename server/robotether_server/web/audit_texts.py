"""What the lines of the audit log say, in words that stand after the name of who did it. Pure.

A kind that is not here is shown by its code and details alone, as all are in the files for programs.
"""

from collections.abc import Mapping

from robotether_server.db.audit import AuditEvent

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
    "user_role_set": "made {user} a {role}, who was a {was}",
    "group_added": "added group {group}",
    "group_removed": "removed group {group}",
    "group_member_added": "put {user} into group {group}",
    "group_member_removed": "took {user} out of group {group}",
    "site_added": "added site {site}",
    "site_removed": "removed site {site}",
    "token_created": "made API token {token}",
    "token_deleted": "deleted API token {token}",
    "join_token_created": "made join token {token}",
    "join_token_deleted": "deleted join token {token}",
    "ssh_key_added": "added an SSH key",
    "ssh_key_deleted": "deleted an SSH key",
    "robot_added": "announced {robot}",
    "robot_pending": "{robot} joined and waits for approval",
    "robot_approved": "let {robot} in",
    "robot_disabled": "keeps {robot} out",
    "robot_enabled": "lets {robot} in again",
    "robot_removed": "removed {robot}",
    "robot_renamed": "renamed {was} to {robot}",
    "robot_mac_set": "changed the MAC of {robot}",
    "robot_ports_moved": "moved the ports of {robot}",
    "robot_rekeyed": "forgot the key of {robot}",
    "robot_rotation_requested": "asked {robot} for a new key",
    "robot_settings_set": "changed the policy, guard or shell user of {robot}",
    "robot_page_set": "changed the drive page of {robot}",
    "robot_buttons_set": "changed the buttons of {robot}",
    "key_rejected": "turned a key away that said to be {robot}",
    "key_forgiven": "lets a rejected key ask again",
    "key_refused": "refused an unknown key",
    "key_rotated": "{robot} changed its key",
    "key_claimed": "another machine says to be {robot}",
    "drive_started": "began to drive {robot}",
    "drive_ended": "drives {robot} no more",
    "lease_asked": "asked for the control of {robot}",
    "lease_refused": "did not hand the control of {robot} over to {to}",
    "lease_handed_over": "handed the control of {robot} over to {to}",
    "lease_passed": "got the control of {robot}, as {driver} did not answer",
    "lease_taken": "took the control of {robot} from {driver}",
    "robot_stopped": "stopped {robot}",
    "robot_released": "released {robot} after a stop",
    "operations_refused": "sent what the policy of {robot} refused",
}


class _Known(dict[str, object]):
    def __missing__(self, name: str) -> str:
        return "?"


def sentence(event: AuditEvent) -> str:
    """Return what the line says, or nothing for a kind without words."""
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
    return f"put {event.robot} at {'no site' if site is None else f'site {site}'}"


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

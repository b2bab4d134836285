"""The audit log's events and their kinds, each with its name in the filter and what its line says after who did it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from robotether_server.contract.codes import DRIVE_ENDS, RECORDING_ENDS
from robotether_server.contract.routes import end_words
from robotether_server.schemas import Timestamp
from robotether_server.times import duration_words


@dataclass(frozen=True)
class AuditEvent:
    """One event of the audit log, as an admin sees it."""

    id: int
    at: Timestamp
    actor: str
    kind: str
    robot: str | None
    address: str | None
    details: dict[str, Any]


class _Details(dict[str, object]):
    def __missing__(self, name: str) -> str:
        return "?"


def sentence(event: AuditEvent) -> str:
    """Return what the line says after who did it; a kind that is not known stays as it is."""
    if event.kind not in AUDIT_KINDS:
        return event.kind
    _, words = AUDIT_KINDS[event.kind]
    if callable(words):
        return words(event)
    return words.format_map(_Details(event.details, robot=event.robot or "?"))


def event_names() -> list[tuple[str, str]]:
    """Return each kind of event with its name, by name."""
    return sorted(
        ((kind, name) for kind, (name, _) in AUDIT_KINDS.items()),
        key=lambda pair: pair[1],
    )


def _grant_sentence(event: AuditEvent) -> str:
    return f"gave {_holder(event)} the right to {event.details.get('level', '?')} {_scope(event)}"


def _removal_sentence(event: AuditEvent) -> str:
    return (
        f"took from {_holder(event)} the right to {event.details.get('level', '?')} {_scope(event)}"
    )


def _site_sentence(event: AuditEvent) -> str:
    site = event.details.get("site")
    if site is None:
        return f"removed {event.robot} from its site"
    return f"moved {event.robot} to site {site}"


def _shell_sentence(event: AuditEvent) -> str:
    return f"turned the shell of {event.robot} {'on' if event.details.get('shell') else 'off'}"


def _drive_sentence(event: AuditEvent) -> str:
    lasted, code = event.details.get("lasted_s"), event.details.get("end_code")
    after = "" if lasted is None else f" after {duration_words(lasted)}"
    return f"stopped driving {event.robot}{after}" + (
        f" ({DRIVE_ENDS.get(code, code)})" if code else ""
    )


def _app_sentence(event: AuditEvent) -> str:
    lasted, code = event.details.get("lasted_s"), event.details.get("end_code")
    after = "" if lasted is None else f" after {duration_words(lasted)}"
    why = str(DRIVE_ENDS.get(str(code), code)).replace("driver", "app")
    return f"disconnected app {event.details.get('app', '?')}{after} ({why})"


def _recording_sentence(event: AuditEvent) -> str:
    number, code = event.details.get("recording", "?"), event.details.get("end_code", "?")
    return f"ended recording {number} of {event.robot} ({RECORDING_ENDS.get(code, code)})"


def _refusal_sentence(event: AuditEvent) -> str:
    count = sum(event.details.values())
    return f"sent {event.robot} what is not allowed: {count} {'message' if count == 1 else 'messages'} blocked"


def _pass_sentence(event: AuditEvent) -> str:
    if event.details.get("why") == "right_ended":
        return f"no longer helps {event.robot}, without the right to drive it"
    if event.details.get("why") == "assigned_another":
        return f"took the offer to help {event.robot} from {event.details.get('user')}"
    return f"let the offer to help {event.robot} pass"


def _route_sentence(done: str) -> Callable[[AuditEvent], str]:
    def words(event: AuditEvent) -> str:
        details = _Details(event.details)
        start = f"{details['source']} {details['source_topic']}"
        target = event.details.get("target", event.robot)
        return f"{done} route {details['route']} from {start} to {target} {details['target_topic']}"

    return words


def _route_end_sentence(event: AuditEvent) -> str:
    details = _Details(event.details)
    why = end_words(str(details["end_code"]))
    target = event.details.get("target", event.robot)
    return f"lost route {details['route']} from {details['source']} to {target}: {why}"


def _holder(event: AuditEvent) -> str:
    group = event.details.get("group")
    return f"{event.details.get('user', '?')}" if group is None else f"group {group}"


def _scope(event: AuditEvent) -> str:
    if event.details.get("all"):
        return "all robots"
    site = event.details.get("site")
    return f"{event.robot}" if site is None else f"site {site}"


# Each kind's name in the filter, and what its line says after who did it: a sentence, or what makes it. {robot} is the
# line's robot; the others are its details, `?` where one is missing.
AUDIT_KINDS: Mapping[str, tuple[str, str | Callable[[AuditEvent], str]]] = {
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
    "grant_given": ("Grant given", _grant_sentence),
    "grant_taken": ("Grant removed", _removal_sentence),
    "site_added": ("Site added", "added site {site}"),
    "site_removed": ("Site removed", "removed site {site}"),
    "cell_drained": ("Machine out of service", "took cell {cell} out of service"),
    "cell_resumed": ("Machine in service again", "put cell {cell} back into service"),
    "cell_removed": ("Machine removed", "removed cell {cell}"),
    "records_restored": ("Backup restored", "restored a backup with the records of {records_of}"),
    "lines_lost": ("Lines lost", "could not write {count} lines from {since} to {until}"),
    "token_created": ("API token created", "created API token {token}"),
    "token_deleted": ("API token deleted", "deleted API token {token}"),
    "join_token_created": ("Join token created", "created join token {token}"),
    "join_token_deleted": ("Join token deleted", "deleted join token {token}"),
    "ssh_key_added": ("SSH key added", "added an SSH key"),
    "ssh_key_deleted": ("SSH key deleted", "deleted an SSH key"),
    "chain_started": ("Audit chain started", "started a chain of the audit log"),
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
    "robot_version": (
        "Agent's version changed",
        "{robot} runs version {agent_version} of the agent",
    ),
    "robot_settings_set": ("Robot's settings changed", "changed the settings of {robot}"),
    "robot_page_set": ("Robot's drive page changed", "changed the drive page of {robot}"),
    "robot_buttons_set": ("Robot's buttons changed", "changed the buttons of {robot}"),
    "robot_site_set": ("Robot's site changed", _site_sentence),
    "robot_shell_set": ("Robot's shell turned on or off", _shell_sentence),
    "key_rejected": ("Key rejected", "rejected a key that claimed to be {robot}"),
    "key_forgiven": ("Key allowed again", "allowed a rejected key to ask again"),
    "key_refused": ("Key refused", "refused an unknown key"),
    "key_rotated": ("Key changed", "{robot} changed its key"),
    "key_claimed": ("Key claimed", "another machine claims to be {robot}"),
    "key_released": ("Key released", "released the key of {robot} for another robot"),
    "mac_changed": ("MAC differs", "{robot} joined with its key from another MAC"),
    "drive_started": ("Drive started", "started driving {robot}"),
    "drive_ended": ("Drive ended", _drive_sentence),
    "calls_started": ("Calls started", "took control of {robot} for calls over HTTP"),
    "calls_ended": ("Calls ended", "ended control of {robot} for calls over HTTP"),
    "service_called": ("Service called", "called service {service} of {robot}"),
    "lease_asked": ("Control asked for", "asked for control of {robot}"),
    "lease_refused": ("Control refused", "refused {to} control of {robot}"),
    "lease_handed_over": ("Control handed over", "handed control of {robot} to {to}"),
    "lease_passed": ("Control passed on", "got control of {robot}, because {driver} did not reply"),
    "lease_taken": ("Control taken", "took control of {robot} from {driver}"),
    "robot_stopped": ("Robot stopped", "stopped {robot}"),
    "robot_released": ("Robot released", "released {robot} after a stop"),
    "request_made": ("Help requested", "asked for help with {robot}: {reason}"),
    "request_raised": ("Request more urgent", "asked for help with {robot} again: {reason}"),
    "request_offered": ("Request offered", "offered {user} to help {robot}"),
    "request_assigned": ("Request assigned", "assigned {user} to help {robot}"),
    "request_accepted": ("Request accepted", "accepted to help {robot}"),
    "request_declined": ("Request declined", "declined to help {robot}"),
    "request_passed": ("Request passed on", _pass_sentence),
    "request_closed": ("Request closed", "closed the request of {robot}"),
    "request_cancelled": ("Request cancelled", "cancelled the request of {robot}"),
    "user_pools_set": ("User's pools changed", "changed the pools of {user}"),
    "recording_started": ("Recording started", "started recording {recording} of {robot}"),
    "recording_ended": ("Recording ended", _recording_sentence),
    "recording_downloaded": (
        "Recording's file requested",
        "requested the file of recording {recording} of {robot}",
    ),
    "recording_viewed": ("Recording opened", "opened recording {recording} of {robot}"),
    "recording_deleted": ("Recording deleted", "deleted recording {recording} of {robot}"),
    "app_connected": ("App connected", "connected app {app}"),
    "app_disconnected": ("App disconnected", _app_sentence),
    "route_made": ("Route made", _route_sentence("made")),
    "route_removed": ("Route removed", _route_sentence("removed")),
    "route_ended": ("Route ended", _route_end_sentence),
    "operations_refused": ("Messages blocked", _refusal_sentence),
}

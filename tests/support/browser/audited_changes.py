"""Every change that the API can make, as a walk through all of them, with the line each leaves in the audit log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from api_visitor import Program, new_public_key
from drive_settings import DOCK
from robotether_server.db import Database
from robotether_server.identity import parse_robots_key

KEY = new_public_key()
OTHER_KEY = new_public_key()
REJECTED_KEY = new_public_key()
MAC = "00:1b:44:11:3a:b7"
PASSWORD = "a password that nobody shall read"
# A ticket changes nothing; what it opens the relay writes down.
NO_CHANGE = {("POST", "/tickets")}

Path = str | Callable[["Walk"], str]
Body = dict[str, Any] | None


class Walk:
    """One request after the other, with what the answers before said."""

    def __init__(self, root: Program, program: Program, database: Database) -> None:
        self.root, self.program, self.database = root, program, database
        self.answers: dict[str, Any] = {}

    def events(self) -> list[tuple[str, str, str]]:
        """Kind, actor and details of all that is in the log, the oldest first."""
        with self.database.transaction() as tx:
            rows = tx.rows("SELECT kind, actor, details FROM audit_events ORDER BY id")
        return [(row["kind"], row["actor"], row["details"]) for row in rows]

    def number(self, path: str, member: str) -> int:
        """The number of the first one of a list."""
        return int(self.root.get(path)[member][0]["id"])

    def join(self, key: str, mac: str) -> None:
        """A machine asks to be let in."""
        body = {"mac": mac, "public_key": key, "hostname": "turtle", "agent_version": "0.1.0"}
        answer = self.program.visitor.ask("POST", "/api/v1/join", json=body)
        assert answer.status_code == 202, answer.text


def finger(key: str) -> dict[str, str]:
    """The body that names a key."""
    return {"fingerprint": parse_robots_key(key).fingerprint}


# Method, template of the path, path, body, kind of the line that it leaves.
STEPS: tuple[tuple[str, str, Path, Body, str], ...] = (
    (
        "POST",
        "/users",
        "/users",
        {"name": "zoe", "role": "user", "password": PASSWORD},
        "user_added",
    ),
    ("PATCH", "/users/{user}", "/users/zoe", {"role": "admin"}, "user_role_set"),
    ("PATCH", "/users/{user}", "/users/zoe", {"disabled": True}, "user_disabled"),
    ("PATCH", "/users/{user}", "/users/zoe", {"password": PASSWORD}, "password_set"),
    ("DELETE", "/users/{user}/logins", "/users/zoe/logins", None, "logins_ended"),
    ("POST", "/groups", "/groups", {"name": "crew"}, "group_added"),
    (
        "PUT",
        "/groups/{group}/members/{user}",
        "/groups/crew/members/zoe",
        None,
        "group_member_added",
    ),
    ("POST", "/sites", "/sites", {"name": "lab"}, "site_added"),
    ("PATCH", "/robots/{robot}", "/robots/sim2", {"site": "lab"}, "robot_site_set"),
    ("PATCH", "/robots/{robot}", "/robots/sim2", {"name": "sim9"}, "robot_renamed"),
    ("PATCH", "/robots/{robot}", "/robots/sim9", {"mac": "00:1b:44:11:3a:b9"}, "robot_mac_set"),
    ("PATCH", "/robots/{robot}", "/robots/sim9", {"state": "disabled"}, "robot_disabled"),
    ("PATCH", "/robots/{robot}", "/robots/sim9", {"state": "active"}, "robot_enabled"),
    ("PATCH", "/robots/{robot}", "/robots/sim9", {"shell": True}, "robot_shell_set"),
    (
        "PATCH",
        "/robots/{robot}",
        "/robots/sim9",
        {"settings": {"policy": {"drive": {"call": ["/dock"]}}}},
        "robot_settings_set",
    ),
    ("PUT", "/robots/{robot}/page", "/robots/sim9/page", {"fps": 10}, "robot_page_set"),
    (
        "PUT",
        "/robots/{robot}/buttons",
        "/robots/sim9/buttons",
        {"buttons": [DOCK]},
        "robot_buttons_set",
    ),
    (
        "POST",
        "/grants",
        "/grants",
        {"group": "crew", "site": "lab", "level": "drive"},
        "grant_given",
    ),
    ("PUT", "/grants/{user}/{robot}", "/grants/zoe/sim1", {"level": "drive"}, "grant_given"),
    ("DELETE", "/grants/{user}/{robot}", "/grants/zoe/sim1", None, "grant_taken"),
    (
        "DELETE",
        "/grants/{grant_id}",
        lambda walk: f"/grants/{walk.number('/grants', 'grants')}",
        None,
        "grant_taken",
    ),
    (
        "DELETE",
        "/groups/{group}/members/{user}",
        "/groups/crew/members/zoe",
        None,
        "group_member_removed",
    ),
    ("DELETE", "/groups/{group}", "/groups/crew", None, "group_removed"),
    ("DELETE", "/sites/{site}", "/sites/lab", None, "site_removed"),
    ("POST", "/tokens", "/tokens", {"name": "script"}, "token_created"),
    (
        "DELETE",
        "/tokens/{token_id}",
        lambda walk: f"/tokens/{walk.answers['POST /tokens']['id']}",
        None,
        "token_deleted",
    ),
    (
        "POST",
        "/join-tokens",
        "/join-tokens",
        {"name": "line", "uses": 1, "hours": 1},
        "join_token_created",
    ),
    (
        "DELETE",
        "/join-tokens/{token_id}",
        lambda walk: f"/join-tokens/{walk.number('/join-tokens', 'join_tokens')}",
        None,
        "join_token_deleted",
    ),
    ("POST", "/me/ssh-keys", "/me/ssh-keys", {"name": "desk", "public_key": KEY}, "ssh_key_added"),
    (
        "DELETE",
        "/me/ssh-keys/{key_id}",
        lambda walk: f"/me/ssh-keys/{walk.number('/me/ssh-keys', 'ssh_keys')}",
        None,
        "ssh_key_deleted",
    ),
    ("PUT", "/robots/{robot}", "/robots/turtle", {"mac": MAC, "public_key": KEY}, "robot_approved"),
    (
        "POST",
        "/robots/{robot}/rotate-key",
        "/robots/turtle/rotate-key",
        None,
        "robot_rotation_requested",
    ),
    ("POST", "/robots/{robot}/move-ports", "/robots/turtle/move-ports", None, "robot_ports_moved"),
    ("POST", "/robots/{robot}/rekey", "/robots/turtle/rekey", None, "robot_rekeyed"),
    ("POST", "/join", "/join", None, "robot_pending"),
    (
        "POST",
        "/robots/{robot}/approve",
        "/robots/turtle/approve",
        finger(OTHER_KEY),
        "robot_approved",
    ),
    (
        "POST",
        "/robots/{robot}/reject",
        "/robots/turtle/reject",
        finger(REJECTED_KEY),
        "key_rejected",
    ),
    (
        "DELETE",
        "/rejected-keys/{key_id}",
        lambda walk: f"/rejected-keys/{walk.number('/rejected-keys', 'rejected_keys')}",
        None,
        "key_forgiven",
    ),
    ("DELETE", "/robots/{robot}", "/robots/turtle", None, "robot_removed"),
    ("DELETE", "/users/{user}", "/users/zoe", None, "user_removed"),
)


def take(walk: Walk, step: tuple[str, str, Path, Body, str]) -> list[tuple[str, str, str]]:
    """Take one step; return the lines that it left."""
    method, template, path, body, _ = step
    before = len(walk.events())
    if template == "/join":
        walk.join(OTHER_KEY, MAC)
    else:
        if template == "/robots/{robot}/reject":
            walk.join(REJECTED_KEY, MAC)
            before = len(walk.events())
        answer = walk.root.ask(method, path if isinstance(path, str) else path(walk), body)
        assert answer.status_code in {200, 201, 202, 204}, (step, answer.text)
        walk.answers[f"{method} {template}"] = answer.json if answer.text else None
    return walk.events()[before:]

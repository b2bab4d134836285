"""People's SSH keys, and the configuration for their ssh."""

from __future__ import annotations

import pytest
from api_visitor import API, Program, new_public_key
from robotether_server.identity import parse_robots_key
from web_visitor import Browser


def test_key_is_added_and_deleted_by_its_owner(ann: Program, root: Program) -> None:
    """Nobody else's list has it, and nobody else deletes it."""
    line = new_public_key()
    answer = ann.ask("POST", "/me/ssh-keys", {"name": "laptop", "public_key": line})
    assert answer.status_code == 201
    key = answer.json
    assert (key["name"], key["fingerprint"]) == ("laptop", parse_robots_key(line).fingerprint)
    assert ann.get("/me/ssh-keys") == {"ssh_keys": [key]}
    assert root.get("/me/ssh-keys") == {"ssh_keys": []}
    path = f"/me/ssh-keys/{key['id']}"
    assert root.refused("DELETE", path) == (404, "record_missing")
    assert ann.ask("DELETE", path).status_code == 204
    assert ann.refused("DELETE", path) == (404, "record_missing")


@pytest.mark.parametrize(
    "changes",
    [
        {"name": ""},
        {"public_key": "ssh-ed25519 AAAA"},
        {"public_key": 'command="sh" ' + new_public_key()},
        {"public_key": new_public_key() + "\n" + new_public_key()},
        {"public_key": "-----BEGIN OPENSSH PRIVATE KEY-----"},
        {"keys": []},
    ],
)
def test_wrong_field_is_refused(ann: Program, changes: dict[str, object]) -> None:
    """No options, no second line, and no private key."""
    body = {"name": "laptop", "public_key": new_public_key()} | changes
    assert ann.refused("POST", "/me/ssh-keys", body) == (422, "field_invalid")


def test_key_is_added_once(ann: Program) -> None:
    """A key is unique by name and by key."""
    first, second = new_public_key(), new_public_key()
    ann.ask("POST", "/me/ssh-keys", {"name": "laptop", "public_key": first})
    for name, line in (("laptop", second), ("phone", first)):
        body = {"name": name, "public_key": line}
        assert ann.refused("POST", "/me/ssh-keys", body) == (409, "record_exists")


def test_ssh_config_has_the_shells_that_the_user_may_reach(
    program: Browser, ann: Program, root: Program
) -> None:
    """With a manager's grant for a robot that is active and has its shell on."""
    body = {"mac": "00:1b:44:11:3a:b7", "public_key": new_public_key()}
    root.ask("PUT", "/robots/turtle", body)
    root.ask("PATCH", "/robots/turtle", {"shell": True, "settings": {"shell_user": "pi"}})
    root.ask("PUT", "/grants/ann/turtle", {"level": "drive"})
    assert ann.ask("GET", "/ssh-config").text == ""
    root.ask("PUT", "/grants/ann/turtle", {"level": "manage"})
    answer = program.ask("GET", f"{API}/ssh-config", headers=ann.headers)
    assert answer.content_type == "text/plain; charset=utf-8"
    assert " ".join(answer.text.split()) == (
        "Host turtle HostName 127.0.0.1 Port 24000 HostKeyAlias robotether-turtle "
        "ProxyJump jump@robots.example:2222 User pi"
    )

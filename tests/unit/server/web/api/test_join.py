"""Joining, answer by answer as docs/protocols.md has it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from api_visitor import new_public_key
from robotether_server.store import Database, robots
from web_visitor import Browser, audit_kinds, bearer

MAC = "02:00:00:00:61:01"


@pytest.fixture
def key(tmp_path: Path) -> str:
    """A robot's public key."""
    file = tmp_path / "robot_key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", file], check=True)
    return file.with_suffix(".pub").read_text()


def join_body(key: str, **changes: object) -> dict[str, object]:
    body = {"mac": MAC, "public_key": key, "hostname": "turtle", "agent_version": "0.1.0"}
    return body | changes


def test_unknown_robot_waits_until_an_admin_approves(
    program: Browser, database: Database, key: str
) -> None:
    """The answer says how; asking again changes nothing, and leaves one audit event in all."""
    for _ in range(2):
        answer = program.ask("POST", "/api/v1/join", json=join_body(key))
        assert answer.status_code == 202
        assert answer.json["code"] == "approval_pending"
        assert answer.json["robot"] == "robot-006101"
        assert "robotether robot approve robot-006101" in answer.json["detail"]
    assert audit_kinds(database) == [("robot_pending", "robot", "198.51.100.7")]
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "robot-006101").id, "active")
    answer = program.ask("POST", "/api/v1/join", json=join_body(key))
    assert answer.status_code == 200
    assert answer.json == {
        "state": "active",
        "robot": "robot-006101",
        "ssh": {
            "user": "tunnel",
            "host": None,
            "ports": [2222, 443],
            "host_keys": ["ssh-ed25519 AAAAhost"],
        },
    }


def test_join_with_an_admins_token_is_active_at_once(
    program: Browser, database: Database, key: str
) -> None:
    """Any other token does not do."""
    token = bearer(database, "root")["Authorization"].split()[1]
    answer = program.ask("POST", "/api/v1/join", json=join_body(key, token=token))
    assert (answer.status_code, answer.json["state"]) == (200, "active")
    users_token = bearer(database, "ann")["Authorization"].split()[1]
    for wrong, status in (("rt_nobodys", 401), (users_token, 403)):
        stranger = join_body(new_public_key(), mac="02:00:00:00:61:02", token=wrong)
        assert program.ask("POST", "/api/v1/join", json=stranger).status_code == status


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"mac": "rubbish"}, "mac"),
        ({"mac": None}, "mac"),
        ({"public_key": "ssh-rsa AAAA"}, "public_key"),
        ({"public_key": 'command="sh" ssh-ed25519 AAAA'}, "public_key"),
        ({"hostname": ""}, "hostname"),
        ({"hostname": "x" * 254}, "hostname"),
        ({"hostname": "a\x1b[2J"}, "hostname"),
        ({"agent_version": 1}, "agent_version"),
        ({"token": 5}, "token"),
    ],
)
def test_join_names_the_field_that_is_wrong(
    program: Browser, key: str, changes: dict[str, object], named: str
) -> None:
    """422, and a sentence with the field's name."""
    answer = program.ask("POST", "/api/v1/join", json=join_body(key, **changes))
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")
    assert named in answer.json["detail"]


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"\xff\xfe", b"null"])
def test_join_without_an_object_is_refused(program: Browser, body: bytes) -> None:
    """Broken JSON is a wrong body, not a failure of the server."""
    kind = "application/json"
    answer = program.ask("POST", "/api/v1/join", data=body, content_type=kind)
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")

"""What admins do about a robot's key and ports."""

from __future__ import annotations

import pytest
from api_visitor import Program, new_public_key
from robotether_server.db import Database
from robotether_server.ssh_keys import parse
from web_visitor import Browser, audit_kinds

MAC = "00:1b:44:11:3a:b7"


@pytest.fixture
def fingerprint(program: Browser) -> str:
    """The key that waits at sim1, which was announced."""
    return join(program, "02:00:00:00:51:01")


def join(program: Browser, mac: str) -> str:
    """The fingerprint of a key that joined."""
    key = new_public_key()
    body = {"mac": mac, "public_key": key, "hostname": "turtle", "agent_version": "0.1.0"}
    assert program.ask("POST", "/api/v1/join", json=body).status_code == 202
    return parse(key).fingerprint


def test_waiting_key_is_approved(root: Program, database: Database, fingerprint: str) -> None:
    """The robot is active with it."""
    answer = root.ask("POST", "/robots/sim1/approve", {"fingerprint": fingerprint})
    assert answer.status_code == 200
    assert (answer.json["state"], answer.json["fingerprint"]) == ("active", fingerprint)
    assert ("robot_approved", "root", "198.51.100.7") in audit_kinds(database)


@pytest.mark.parametrize("action", ["approve", "reject"])
def test_no_other_key_than_the_named_one(root: Program, fingerprint: str, action: str) -> None:
    """Whatever came since the admin compared them."""
    path = f"/robots/sim1/{action}"
    assert root.refused("POST", path, {"fingerprint": "SHA256:other"}) == (409, "not_possible")
    assert root.refused("POST", path, {}) == (422, "field_invalid")
    assert root.refused("POST", path) == (415, "unsupported_media_type")
    ghost = f"/robots/ghost/{action}"
    assert root.refused("POST", ghost, {"fingerprint": fingerprint}) == (404, "record_missing")


def test_rejected_key_is_forgotten_at_the_robot(root: Program, fingerprint: str) -> None:
    """It waits for its first key again."""
    answer = root.ask("POST", "/robots/sim1/reject", {"fingerprint": fingerprint})
    assert (answer.status_code, answer.data) == (204, b"")
    assert root.get("/robots/sim1")["fingerprint"] is None


def test_second_key_of_a_mac_can_take_the_place(
    root: Program, program: Browser, fingerprint: str
) -> None:
    """A claim is approved by its fingerprint, as a row's key is."""
    root.ask("POST", "/robots/sim1/approve", {"fingerprint": fingerprint})
    second = join(program, "02:00:00:00:51:01")
    answer = root.ask("POST", "/robots/sim1/approve", {"fingerprint": second})
    assert (answer.status_code, answer.json["fingerprint"]) == (200, second)


def test_key_is_rotated_or_forgotten(root: Program, fingerprint: str) -> None:
    """The agent is asked for a new one; or the next one waits."""
    assert root.refused("POST", "/robots/sim1/rotate-key") == (409, "not_possible")
    root.ask("POST", "/robots/sim1/approve", {"fingerprint": fingerprint})
    answer = root.ask("POST", "/robots/sim1/rotate-key")
    assert (answer.status_code, answer.json["rotate_key"]) == (200, True)
    answer = root.ask("POST", "/robots/sim1/rekey")
    assert (answer.status_code, answer.json["fingerprint"]) == (200, None)
    assert (answer.json["state"], answer.json["rotate_key"]) == ("pending", False)


def test_ports_are_moved_to_another_pair(root: Program) -> None:
    """To a free one."""
    answer = root.ask("POST", "/robots/sim1/move-ports")
    assert answer.status_code == 200
    assert (answer.json["ros_port"], answer.json["video_port"]) == (20004, 20005)


def test_waiting_key_is_rejected_and_forgiven(root: Program, program: Browser) -> None:
    """From one list to the other, and out of it."""
    key = new_public_key()
    body = {"mac": MAC, "public_key": key, "hostname": "turtle", "agent_version": "0.1.0"}
    program.ask("POST", "/api/v1/join", json=body)
    [waiting] = root.get("/pending")["pending"]
    assert waiting.pop("joined_at").endswith("Z")
    assert waiting == {
        "robot": "robot-113ab7",
        "mac": MAC,
        "hostname": "turtle",
        "address": "198.51.100.7",
        "fingerprint": parse(key).fingerprint,
        "agent_version": "0.1.0",
        "reason": "approval_pending",
    }
    chosen = {"fingerprint": waiting["fingerprint"]}
    assert root.ask("POST", "/robots/robot-113ab7/reject", chosen).status_code == 204
    assert root.get("/pending") == {"pending": []}
    [rejected] = root.get("/rejected-keys")["rejected_keys"]
    assert (rejected["fingerprint"], rejected["robot"]) == (waiting["fingerprint"], "robot-113ab7")
    assert rejected["rejected_by"] == "root"
    assert program.ask("POST", "/api/v1/join", json=body).json["code"] == "key_rejected"
    path = f"/rejected-keys/{rejected['id']}"
    assert root.ask("DELETE", path).status_code == 204
    assert root.refused("DELETE", path) == (404, "record_missing")
    assert program.ask("POST", "/api/v1/join", json=body).status_code == 202

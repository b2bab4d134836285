"""Keys that wait, and those that were turned away."""

from __future__ import annotations

from api_visitor import Program, new_public_key
from robotether_server.ssh_keys import parse
from web_visitor import Browser

MAC = "00:1b:44:11:3a:b7"


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

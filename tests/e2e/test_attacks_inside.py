"""What somebody on the tunnel network without any secret tries: another container there, or a part that was taken over.

The network is for sshd, relay and nginx alone. Should somebody else get there, the robots' guards still ask for their
keys, and the relay for its own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from insider import UNREACHABLE, Insider, insider
from stack import Stack

VICTIM = "sim1"


@pytest.fixture(scope="module")
def inside(stack: Stack) -> Iterator[Insider]:
    """Somebody on the tunnel network, where the victim's guard answers: a test before may have restarted it."""
    [[port]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    with insider(stack) as somebody:
        stack.wait(
            f"{VICTIM} behind its port",
            lambda: somebody.get("sshd", int(port)).startswith("HTTP/1.1 426 "),
            VICTIM,
            "relay",
        )
        yield somebody


FORBIDDEN, UNAUTHORIZED = "HTTP/1.1 403 Forbidden", "HTTP/1.1 401 Unauthorized"
FALSE_KEY = {"Robotether_Key": "x" * 43, "Robotether_Mode": "drive", "Robotether_Fence": "999999"}


@pytest.mark.parametrize(
    "headers",
    [
        {},
        FALSE_KEY,
        {**FALSE_KEY, "Robotether_Key": ""},
        {**FALSE_KEY, "Robotether_Mode": "observe"},
    ],
    ids=["none", "wrong", "empty", "observing"],
)
def test_a_robots_port_opens_with_its_key_only(
    inside: Insider, stack: Stack, headers: dict[str, str]
) -> None:
    """The forwarded port is no secret; the guard behind it asks for the key of this very session."""
    [[port]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    assert inside.upgrade("sshd", int(port), **headers) == FORBIDDEN


def test_a_robots_port_answers_no_plain_request(inside: Insider, stack: Stack) -> None:
    """Nothing but a WebSocket is spoken there."""
    [[port]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    assert inside.get("sshd", int(port)).startswith("HTTP/1.1 426 ")
    assert inside.get("sshd", int(port), "/", "POST").split()[1] in {"405", "426"}


PREFACE = {
    "type": "preface", "kind": "session", "robot_id": 1, "fingerprint": "", "ports": [], "address": "192.0.2.1",
}  # fmt: skip


@pytest.mark.parametrize(
    "first",
    [PREFACE, {**PREFACE, "session_key": ""}, {**PREFACE, "session_key": "0" * 64}, {**PREFACE, "session_key": 0},
     {"type": "hello", "hostname": "x", "agent_version": "1"}],
)  # fmt: skip
def test_the_relay_takes_no_session_without_its_key(inside: Insider, first: object) -> None:
    """Only sshd's session command can say who a robot is; others get no answer."""
    assert inside.send("relay", 8091, json.dumps(first).encode() + b"\n") == ""


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", f"/api/v1/robots/{VICTIM}/stop"),
        ("POST", f"/api/v1/robots/{VICTIM}/release"),
        ("POST", f"/api/v1/robots/{VICTIM}/lease"),
        ("POST", "/api/v1/stop"),
        ("GET", f"/api/v1/robots/{VICTIM}/control"),
        ("GET", "/api/v1/events"),
        ("GET", f"/robots/{VICTIM}/video/stream"),
    ],
)
def test_the_relay_knows_nobody_by_headers(inside: Insider, method: str, path: str) -> None:
    """Behind nginx one can say anything about where one comes from; it opens nothing."""
    said = {"X_Forwarded_For": "127.0.0.1", "X_Forwarded_Proto": "https", "X_CSRFToken": "x"}
    assert inside.get("relay", 8080, path, method, **said) == UNAUTHORIZED


@pytest.mark.parametrize(
    ("host", "port"), [("mysql", 3306), ("web", 8000), (VICTIM, 9090), (VICTIM, 8080)]
)
def test_other_networks_are_out_of_reach(inside: Insider, host: str, port: int) -> None:
    """Neither the database nor the web, nor a robot's own machine."""
    assert inside.send(host, port, b"x") == UNREACHABLE

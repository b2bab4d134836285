"""What somebody on the tunnel network without any secret tries: another container there, or a part that was taken over.

The network is for sshd, relay and nginx alone. Should somebody else get there, the robots' guards still ask for their
keys, and the relay for its own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from insider import Insider, insider
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


def test_a_robots_port_and_the_relay_open_with_their_keys_only(
    inside: Insider, stack: Stack
) -> None:
    """The forwarded port is no secret: the guard behind it asks for its session's key, and the relay for sshd's."""
    [[port]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    wrong = {"Robotether_Key": "x" * 43, "Robotether_Mode": "drive", "Robotether_Fence": "999999"}
    for headers in ({}, wrong, {**wrong, "Robotether_Key": ""}):
        assert inside.upgrade("sshd", int(port), **headers) == "HTTP/1.1 403 Forbidden"
    preface = {
        "type": "preface", "kind": "session", "robot_id": 1, "fingerprint": "", "ports": [], "address": "192.0.2.1",
    }  # fmt: skip
    for first in (preface, {**preface, "session_key": "0" * 64}):
        assert inside.send("relay", 8091, json.dumps(first).encode() + b"\n") == ""

"""What somebody on the tunnel network without any secret tries: another container there, or a part that was taken over.

The network is for sshd, relay and nginx alone. Should somebody else get there, the robots' guards still ask for their
keys, and the relay for its own. It has an address of its own, from which half-open log-ins keep nobody else out.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from insider import Insider, insider
from jump_people import ShellRobot
from robot_key import RobotKey
from stack import Stack

VICTIM = "sim1"
USER = "tunnel@127.0.0.1"
HALF_OPEN = 40
LOG_INS = 4


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


@pytest.fixture(scope="module")
def key(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotKey]:
    """The key of an active robot that no agent uses."""
    folder = tmp_path_factory.mktemp("keys")
    with ShellRobot.added(stack, folder, "kept-out", "00:00:5e:00:53:73") as robot:
        yield robot.key


def log_in(key: RobotKey, port: int) -> str:
    said = key.ssh("-v", USER, "id", port=port, timeout=45).stderr
    return "in" if "Authenticated to" in said else said[-400:]


@pytest.mark.parametrize("door", ["2222", "443"])
def test_half_open_log_ins_of_one_address_keep_nobody_out(
    stack: Stack, inside: Insider, key: RobotKey, door: str
) -> None:
    host, attacked = {"2222": ("sshd", 2222), "443": ("nginx", 8443)}[door]
    port = {"2222": stack.ssh_port, "443": stack.https_port}[door]
    with inside.half_open_log_ins(host, attacked, HALF_OPEN), ThreadPoolExecutor(LOG_INS) as pool:
        got = list(pool.map(lambda _: log_in(key, port), range(LOG_INS)))
    assert got == ["in"] * LOG_INS

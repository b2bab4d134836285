"""One address that begins log-ins and never ends them keeps nobody else out, on sshd's port and behind 443.

The attacker is a container on the tunnel network and so has an address of its own; the others log in from this machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from insider import Insider, insider
from robot_key import RobotKey
from stack import Stack

USER = "tunnel@127.0.0.1"
HALF_OPEN = 40
LOG_INS = 8
AT_ONCE = 4


@pytest.fixture
def inside(stack: Stack) -> Iterator[Insider]:
    """The attacker."""
    with insider(stack) as somebody:
        yield somebody


@pytest.fixture
def key(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotKey]:
    """The key of an active robot that no agent uses."""
    mac = "00:00:5e:00:53:73"
    robot = RobotKey(stack, tmp_path_factory.mktemp("keys"), "kept-out")
    stack.robotether("robot", "add", robot.name, "--mac", mac)
    try:
        assert robot.join(mac)[0] == 202
        stack.robotether("robot", "approve", robot.name, "--yes")
        yield robot
    finally:
        stack.robotether("robot", "remove", robot.name, "--yes")


def log_in(key: RobotKey, port: int) -> str:
    """Log in once; `in`, or what the client says."""
    said = key.ssh("-v", USER, "id", port=port, timeout=45).stderr
    return "in" if "Authenticated to" in said else said[-400:]


@pytest.mark.parametrize("door", ["2222", "443"])
def test_half_open_log_ins_of_one_address_keep_nobody_out(
    stack: Stack, inside: Insider, key: RobotKey, door: str
) -> None:
    host, attacked = {"2222": ("sshd", 2222), "443": ("nginx", 8443)}[door]
    port = {"2222": stack.ssh_port, "443": stack.https_port}[door]
    with inside.half_open_log_ins(host, attacked, HALF_OPEN), ThreadPoolExecutor(AT_ONCE) as pool:
        got = list(pool.map(lambda _: log_in(key, port), range(LOG_INS)))
    assert got == ["in"] * LOG_INS

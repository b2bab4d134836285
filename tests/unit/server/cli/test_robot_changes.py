"""robotether robot disable, enable, rename, set-mac, move-ports, shell."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from admin_records import ADD, activate, kinds, robot, show_key
from robotether_server.db import Database

Run = Callable[..., Any]


@pytest.fixture(autouse=True)
def _sim1(run: Run) -> None:
    run(*ADD)


def test_robot_is_disabled_and_enabled(run: Run, database: Database) -> None:
    """Each change has one audit event."""
    activate(database)
    assert run("robot", "disable", "sim1").out == "robot sim1 is disabled\n"
    assert run("robot", "enable", "sim1").out == "robot sim1 is active\n"
    assert "it is active, not disabled" in run("robot", "enable", "sim1").err
    assert kinds(database)[1:] == ["robot_disabled", "robot_enabled"]


def test_enable_approves_no_key_in_passing(run: Run, database: Database) -> None:
    """The key of a robot that nobody has approved is forgotten when it is disabled."""
    show_key(database)
    run("robot", "disable", "sim1")
    assert run("robot", "enable", "sim1").out == "robot sim1 is pending\n"
    assert "has not joined yet" in run("robot", "approve", "sim1", "--yes").err


def test_robot_gets_another_name(run: Run, database: Database) -> None:
    """Which must be free, and a name."""
    assert run("robot", "rename", "sim1", "turtle").out == "robot sim1 is turtle now\n"
    run("robot", "add", "sim2", "--mac", "00:1b:44:11:3a:b7")
    assert "another robot has it" in run("robot", "rename", "sim2", "turtle").err
    assert run("robot", "rename", "sim2", "No Name").status == 1
    assert kinds(database).count("robot_renamed") == 1


def test_robot_gets_another_mac(run: Run, database: Database) -> None:
    """In one spelling; one that a machine has given itself only when that is said."""
    done = run("robot", "set-mac", "sim1", "001B.4411.3AB7")
    assert done.out == "robot sim1 has MAC 00:1b:44:11:3a:b7\n"
    assert "locally administered" in run("robot", "set-mac", "sim1", "02:00:00:00:00:07").err
    arguments = ("set-mac", "sim1", "02:00:00:00:00:07", "--allow-local-mac")
    assert run("robot", *arguments).status == 0
    assert robot(database).mac == "02:00:00:00:00:07"


def test_robot_moves_to_other_ports(run: Run, database: Database) -> None:
    """To those that are given, or to any that are free."""
    arguments = ("--ros", "20100", "--video", "20101")
    done = run("robot", "move-ports", "sim1", *arguments)
    assert done.out == "robot sim1 has ports 20100 and 20101\n"
    assert "go together" in run("robot", "move-ports", "sim1", "--ros", "20102").err
    run("robot", "move-ports", "sim1")
    assert robot(database).ros_port != 20100


def test_shell_has_a_port_while_it_is_on(run: Run, database: Database) -> None:
    """And none afterwards."""
    port = 24000
    done = run("robot", "shell", "sim1", "on")
    assert done.out == f"the shell of robot sim1 is on, at port {port} of the server\n"
    assert robot(database).shell_port == port
    assert run("robot", "shell", "sim1", "off").out == "the shell of robot sim1 is off\n"
    assert robot(database).shell_port is None

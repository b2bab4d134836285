"""A robot's key, robots with a shell, and people who reach it through `jump`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from jump_people import Person, ShellRobot
from robot_key import RobotKey
from stack import Stack


@pytest.fixture(scope="module")
def key(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotKey]:
    """The key of an active robot that no agent uses."""
    robot = RobotKey(stack, tmp_path_factory.mktemp("keys"), "thief")
    stack.robotether("robot", "add", "thief", "--mac", "00:00:5e:00:53:60")
    status, _ = robot.join("00:00:5e:00:53:60")
    assert status == 202
    stack.robotether("robot", "approve", "thief", "--yes")
    yield robot
    stack.admin.remove("robots", "thief")


@pytest.fixture(scope="module")
def robot(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShellRobot]:
    """A robot whose shell listens."""
    made = ShellRobot(stack, tmp_path_factory.mktemp("robot"), "jumped", "00:00:5e:00:53:61")
    # Whatever happens: names and MACs come again in the next module.
    try:
        with made.listening():
            yield made
    finally:
        made.remove()


@pytest.fixture(scope="module")
def other(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShellRobot]:
    """A robot whose shell listens too, and that ann may only drive."""
    made = ShellRobot(stack, tmp_path_factory.mktemp("other"), "foreign", "00:00:5e:00:53:62")
    try:
        with made.listening():
            yield made
    finally:
        made.remove()


@pytest.fixture
def ann(stack: Stack, tmp_path: Path, robot: ShellRobot, other: ShellRobot) -> Iterator[Person]:
    """Somebody who manages one robot and drives the other."""
    person = Person(stack, tmp_path, "jumping-ann")
    try:
        person.grant(robot, "manage")
        person.grant(other, "drive")
        yield person
    finally:
        person.remove()


@pytest.fixture
def bob(stack: Stack, tmp_path: Path, robot: ShellRobot) -> Iterator[Person]:
    """Somebody else who manages the robot."""
    person = Person(stack, tmp_path, "jumping-bob")
    try:
        person.grant(robot, "manage")
        yield person
    finally:
        person.remove()

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
    folder = tmp_path_factory.mktemp("keys")
    with ShellRobot.added(stack, folder, "thief", "00:00:5e:00:53:60") as made:
        yield made.key


@pytest.fixture(scope="module")
def robot(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShellRobot]:
    """A robot whose shell listens."""
    folder = tmp_path_factory.mktemp("robot")
    with ShellRobot.added(stack, folder, "jumped", "00:00:5e:00:53:61") as made, made.listening():
        yield made


@pytest.fixture(scope="module")
def other(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShellRobot]:
    """A robot whose shell listens too, and that ann may only drive."""
    folder = tmp_path_factory.mktemp("other")
    with ShellRobot.added(stack, folder, "foreign", "00:00:5e:00:53:62") as made, made.listening():
        yield made


@pytest.fixture
def ann(stack: Stack, tmp_path: Path, robot: ShellRobot, other: ShellRobot) -> Iterator[Person]:
    """Somebody who manages one robot and drives the other."""
    levels = {robot: "manage", other: "drive"}
    with Person.added(stack, tmp_path, "jumping-ann", levels) as person:
        yield person


@pytest.fixture
def bob(stack: Stack, tmp_path: Path, robot: ShellRobot) -> Iterator[Person]:
    """Somebody else who manages the robot."""
    with Person.added(stack, tmp_path, "jumping-bob", {robot: "manage"}) as person:
        yield person

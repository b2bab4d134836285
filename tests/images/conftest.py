"""A robot's key, robots with a shell, and people who reach it through `jump`."""

import pytest
from jump_people import Person, ShellRobot


@pytest.fixture(scope="module")
def key(stack, tmp_path_factory):
    """The key of an active robot that no agent uses."""
    folder = tmp_path_factory.mktemp("keys")
    with ShellRobot.added(stack, folder, "thief", "00:00:5e:00:53:60") as made:
        yield made.key


@pytest.fixture(scope="module")
def robot(stack, tmp_path_factory):
    """A robot whose shell listens."""
    folder = tmp_path_factory.mktemp("robot")
    with ShellRobot.added(stack, folder, "jumped", "00:00:5e:00:53:61") as made, made.listening():
        yield made


@pytest.fixture(scope="module")
def other(stack, tmp_path_factory):
    """A robot whose shell listens too, and that ann may only drive."""
    folder = tmp_path_factory.mktemp("other")
    with ShellRobot.added(stack, folder, "foreign", "00:00:5e:00:53:62") as made, made.listening():
        yield made


@pytest.fixture
def ann(stack, tmp_path, robot, other):
    """Somebody who manages one robot and drives the other."""
    levels = {robot: "manage", other: "drive"}
    with Person.added(stack, tmp_path, "jumping-ann", levels) as person:
        yield person


@pytest.fixture
def bob(stack, tmp_path, robot):
    """Somebody else who manages the robot."""
    with Person.added(stack, tmp_path, "jumping-bob", {robot: "manage"}) as person:
        yield person

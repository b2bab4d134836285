"""How a robot is shown."""

import dataclasses
import datetime as dt

from robotether_server.cli import robot_texts
from robotether_server.db.robots import RobotRow
from robotether_server.db.seen_robots import SeenRobot

AT = dt.datetime(2026, 1, 2, 3, 4, 5, tzinfo=dt.UTC)
ROBOT = RobotRow(7, "00:1b:44:11:3a:b7", "sim1", "pending", 20000, 20001, None, {})


def test_robot_that_has_not_joined_says_so():
    """Each field that a join would fill says so."""
    fields = dict(robot_texts.identity(ROBOT))
    assert fields["host name"] == fields["address"] == fields["joined"] == "not joined yet"
    assert fields["key"] == "none yet"


def test_presence_is_told_with_its_time():
    """Online or not."""
    for online, text in ((True, "yes"), (False, "no")):
        fields = dict(robot_texts.everything(SeenRobot(ROBOT, online, AT, "manage")))
        assert fields["online"] == f"{text}, since 2026-01-02 03:04:05 UTC"


def test_site_guard_and_policy_are_told():
    """What differs from the defaults, as the API takes it."""
    fields = dict(robot_texts.everything(SeenRobot(ROBOT, False, None, "manage")))
    assert (fields["site"], fields["settings"]) == ("none", "the defaults")
    settings = {"shell_user": "pi", "guard": {"deadman_ms": 300}}
    assert fields["region"] == "none"
    robot = dataclasses.replace(ROBOT, site="lab", settings=settings | {"region": "eu"})
    fields = dict(robot_texts.everything(SeenRobot(robot, False, None, "manage")))
    assert (fields["site"], fields["settings"]) == ("lab", '{"guard": {"deadman_ms": 300}}')
    assert fields["region"] == "eu"


def test_request_for_a_new_key_is_told():
    """It stays until the robot has made one."""
    for requested_at, words in ((None, "not asked for"), (AT, "asked for")):
        robot = dataclasses.replace(ROBOT, rotate_requested_at=requested_at)
        fields = dict(robot_texts.everything(SeenRobot(robot, False, None, "manage")))
        assert fields["new key"] == words

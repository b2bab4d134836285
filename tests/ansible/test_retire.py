"""retire.yml undoes enroll.yml, on the server and on the robot."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from playbooks import Site
from robot_hosts import RobotHost, RobotHosts


@dataclass
class Enrolled:
    """A robot, and all files that it had before it was enrolled."""

    robot: RobotHost
    before: set[str]


@pytest.fixture(scope="module")
def enrolled(site: Site, hosts: RobotHosts) -> Enrolled:
    """A robot that is to be retired."""
    robot = hosts.boot("veteran")
    before = robot.footprint()
    site.play_well("enroll.yml", robot)
    return Enrolled(robot, before)


def test_no_answer_changes_nothing(enrolled: Enrolled, site: Site) -> None:
    """Without a terminal and without retire_confirm nothing happens."""
    played = site.play("retire.yml", enrolled.robot)
    assert played.code != 0
    played.must_say("nothing changed: the answer was not yes")
    assert site.stack.online("veteran")


def test_a_join_token_may_not(enrolled: Enrolled, site: Site) -> None:
    """A join token lets robots in and retires none."""
    token = site.join_token(uses=1)
    played = site.play("retire.yml", enrolled.robot, token=token, retire_confirm="true")
    played.must_say("that needs an admin's API token")
    assert site.stack.online("veteran")


def test_retired_leaves_nothing(enrolled: Enrolled, site: Site) -> None:
    """After it, also under another name on the server, files, users, units and row are as before the enrolment."""
    status, answer = site.stack.request(
        "PATCH", "/api/v1/robots/veteran", {"name": "renamed"}, {"Authorization": f"Bearer {site.token}"}
    )  # fmt: skip
    assert status == 200, answer
    site.play_well("retire.yml", enrolled.robot, retire_confirm="true")
    assert enrolled.robot.footprint() ^ enrolled.before == set()
    assert not enrolled.robot.succeeds("pgrep -f robotether-agent")
    assert not enrolled.robot.succeeds("systemctl cat robotether-agent")
    rows = site.stack.sql(f"SELECT name FROM robots WHERE mac = '{enrolled.robot.mac}'")
    assert rows == []


def test_retired_twice(enrolled: Enrolled, site: Site) -> None:
    """A robot that is retired already changes nothing."""
    played = site.play_well("retire.yml", enrolled.robot, retire_confirm="true")
    assert played.recaps["veteran"].changed == 0

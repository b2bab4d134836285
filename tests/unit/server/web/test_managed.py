"""Who manages a robot."""

from __future__ import annotations

import pytest
from flask import Flask
from granted import give
from robotether_server.problems import GrantMissing, RobotUnknown
from robotether_server.store import Database, robots, users
from robotether_server.web import managed


def test_managers_and_admins_manage(app: Flask, database: Database) -> None:
    """Drivers are told what they lack; who may not see the robot is told of none."""
    assert app
    with database.transaction() as tx:
        assert managed.find(tx, users.get(tx, "root"), "sim2").robot.name == "sim2"
        ann = users.get(tx, "ann")
        with pytest.raises(GrantMissing, match="your grant is drive"):
            managed.find(tx, ann, "sim1")
        with pytest.raises(RobotUnknown):
            managed.find(tx, ann, "sim2")
        give(tx, ann.id, robots.get(tx, "sim2").id, "manage")
        assert managed.find(tx, ann, "sim2").level == "manage"

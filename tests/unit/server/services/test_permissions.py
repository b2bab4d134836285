"""Who manages a robot."""

from __future__ import annotations

import pytest
from flask import Flask
from granted import give
from robotether_server.db import Database, robots, users
from robotether_server.problems import GrantMissing, RobotUnknown
from robotether_server.services import permissions


def test_managers_and_admins_manage(app: Flask, database: Database) -> None:
    """Drivers are told what they lack; who may not see the robot is told of none."""
    assert app
    with database.transaction() as tx:
        assert permissions.find_managed(tx, users.get(tx, "root"), "sim2").robot.name == "sim2"
        ann = users.get(tx, "ann")
        with pytest.raises(GrantMissing, match="your grant is drive"):
            permissions.find_managed(tx, ann, "sim1")
        with pytest.raises(RobotUnknown):
            permissions.find_managed(tx, ann, "sim2")
        give(tx, ann.id, robots.get(tx, "sim2").id, "manage")
        assert permissions.find_managed(tx, ann, "sim2").level == "manage"

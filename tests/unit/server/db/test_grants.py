"""Grants in the real database."""

from __future__ import annotations

import pytest
from granted import give, take
from robotether_server.db import Database, grants, robots, users
from robotether_server.db.grants import Level


@pytest.mark.parametrize(
    ("held", "asked", "may"),
    [
        ("observe", "observe", True),
        ("observe", "drive", False),
        ("drive", "observe", True),
        ("drive", "drive", True),
        ("drive", "manage", False),
        ("manage", "drive", True),
    ],
)
def test_level_includes_the_lower_ones(held: Level, asked: Level, may: bool) -> None:
    """Who may drive may watch, and not the other way round."""
    assert grants.includes(held, asked) is may


def test_grant_is_replaced_and_taken(database: Database) -> None:
    """One level for a user and a robot; without it the robot is not seen."""
    with database.transaction() as tx:
        user_id = users.add(tx, "ann", "x", "user")
        robot_id = robots.add(tx, "02:00:00:00:00:01", "a")
        give(tx, user_id, robot_id, "drive")
        give(tx, user_id, robot_id, "observe")
        ann = users.get(tx, "ann")
        assert [seen.level for seen in robots.list_seen(tx, ann)] == ["observe"]
        take(tx, user_id, robot_id)
        assert robots.list_seen(tx, ann) == []

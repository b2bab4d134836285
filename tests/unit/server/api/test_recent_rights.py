"""The rights that web remembers for a while, for when the database is away."""

from __future__ import annotations

import pytest
from robotether_server.api import recent_rights
from robotether_server.api.recent_rights import CredentialKey, RecentRight, RecentRights

LOGIN: CredentialKey = ("login", "0f")
TOKEN: CredentialKey = ("token", "0f")
RIGHT = RecentRight(1, "ann", 7, "drive")


def test_a_right_is_found_for_its_credential_and_robot_until_its_time_is_over() -> None:
    now = 0.0
    rights = RecentRights(lambda: now)
    rights.note(LOGIN, "sim1", RIGHT)
    now = recent_rights.RECENT_S - 1
    assert rights.find(LOGIN, "sim1") == RIGHT
    assert rights.find(LOGIN, "sim2") is None
    assert rights.find(TOKEN, "sim1") is None
    now = recent_rights.RECENT_S
    assert rights.find(LOGIN, "sim1") is None
    rights.note(LOGIN, "sim1", RIGHT)
    assert rights.find(LOGIN, "sim1") == RIGHT


def test_what_is_denied_is_forgotten_alone() -> None:
    """One robot, or all of a login or token."""
    rights = RecentRights(lambda: 0.0)
    for credential in (LOGIN, TOKEN):
        for robot in ("sim1", "sim2", "sim3"):
            rights.note(credential, robot, RIGHT)
    rights.forget(LOGIN, "sim1")
    rights.forget(TOKEN)
    found = [rights.find(LOGIN, robot) for robot in ("sim1", "sim2", "sim3")]
    assert found == [None, RIGHT, RIGHT]
    assert [rights.find(TOKEN, robot) for robot in ("sim1", "sim2", "sim3")] == [None] * 3


def test_rights_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was confirmed longest ago goes first."""
    monkeypatch.setattr(recent_rights, "MAX_RECENT", 2)
    rights = RecentRights(lambda: 0.0)
    for robot in ("sim1", "sim2", "sim1", "sim3"):
        rights.note(LOGIN, robot, RIGHT)
    found = [rights.find(LOGIN, robot) for robot in ("sim1", "sim2", "sim3")]
    assert found == [RIGHT, None, RIGHT]

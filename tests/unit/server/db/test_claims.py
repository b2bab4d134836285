"""Keys that no robot has: claims go with their robot, rejected keys stay."""

from __future__ import annotations

import datetime as dt

import pytest
from robotether_server.db import Database, claims, robots
from robotether_server.db.robots import Report, Robot
from robotether_server.problems import RecordExists, RecordMissing
from robotether_server.ssh_keys import PublicKey

MAC = "00:1b:44:11:3a:b7"
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:a")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:b")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")


@pytest.fixture
def robot(database: Database) -> Robot:
    """A robot with a key of its own."""
    with database.transaction() as tx:
        robots.set_key(tx, robots.add(tx, MAC, "sim1"), KEY, REPORT)
        return robots.get(tx, "sim1")


def test_claim_waits_under_its_robots_present_name(database: Database, robot: Robot) -> None:
    """With what it told when it asked; the same key claims once."""
    with database.transaction() as tx:
        claims.add(tx, robot, OTHER_KEY, REPORT)
        robots.rename(tx, robot.id, "turtle1")
        (claim,) = claims.waiting(tx)
        assert claims.find(tx, OTHER_KEY.fingerprint) == claim
        assert claims.find(tx, KEY.fingerprint) is None
        with pytest.raises(RecordExists):
            claims.add(tx, robot, OTHER_KEY, REPORT)
    assert (claim.robot, claim.robot_id, claim.mac) == ("turtle1", robot.id, MAC)
    assert (claim.key, claim.report, claim.is_rejected) == (OTHER_KEY, REPORT, False)


def test_claim_goes_with_its_robot_and_a_rejected_key_stays(
    database: Database, robot: Robot
) -> None:
    """It keeps the name that its robot had."""
    with database.transaction() as tx:
        claims.add(tx, robot, OTHER_KEY, REPORT)
        claims.add_rejected(tx, robot, "root")
        robots.remove(tx, robot.id)
        assert claims.waiting(tx) == []
        (rejected,) = claims.rejected(tx)
        assert claims.get_rejected(tx, rejected.id) == rejected
    assert (rejected.robot, rejected.rejected_by, rejected.key) == ("sim1", "root", KEY)
    assert rejected.is_rejected


def test_rejected_claim_waits_no_more(database: Database, robot: Robot) -> None:
    """Until it is forgotten, when nothing is left of it."""
    with database.transaction() as tx:
        claims.add(tx, robot, OTHER_KEY, REPORT)
        (claim,) = claims.waiting(tx)
        with pytest.raises(RecordMissing):
            claims.get_rejected(tx, claim.id)
        claims.reject(tx, claim.id, "sim1", "root")
        assert claims.waiting(tx) == []
        assert [one.key for one in claims.rejected(tx)] == [OTHER_KEY]
        claims.remove(tx, claim.id)
        assert claims.find(tx, OTHER_KEY.fingerprint) is None


def test_only_old_claims_are_removed(database: Database, robot: Robot) -> None:
    """Rejected keys are remembered for good."""
    now = dt.datetime.now(dt.UTC)
    with database.transaction() as tx:
        claims.add_rejected(tx, robot, "root")
        claims.add(tx, robot, OTHER_KEY, REPORT)
        claims.remove_old(tx, now - dt.timedelta(hours=1))
        assert len(claims.waiting(tx)) == 1
        claims.remove_old(tx, now + dt.timedelta(hours=1))
        assert (len(claims.waiting(tx)), len(claims.rejected(tx))) == (0, 1)

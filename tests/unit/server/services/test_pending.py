"""Keys that wait, and those that were rejected."""

import pytest
from joins import MAC, OTHER_KEY, OTHER_MAC, age
from robotether_server.db import robots
from robotether_server.db.audit import Source
from robotether_server.identity import PublicKey
from robotether_server.problems import RecordMissingError
from robotether_server.services import pending
from robotether_server.services import robots as robot_service

ADMIN = Source("root")
THIRD_KEY = PublicKey("ssh-ed25519 C", "SHA256:c")


def test_waiting_keys_of_both_kinds_stand_oldest_first(site):
    """Robots that are active, or have shown no key, are not among them."""
    site.announce("planned", "00:1b:44:00:61:09")
    site.ask(key=OTHER_KEY)
    with site.database.transaction() as tx:
        age(tx, 1)
        robots.rename(tx, robots.get(tx, "sim1").id, "turtle1")
    name = site.ask(OTHER_MAC, THIRD_KEY).robot
    with site.database.transaction() as tx:
        found = pending.waiting(tx)
    assert [(item.robot, item.mac, item.fingerprint, item.reason) for item in found] == [
        ("turtle1", MAC, "SHA256:b", "mac_in_use"),
        (name, OTHER_MAC, "SHA256:c", "approval_pending"),
    ]
    assert {(item.hostname, item.address, item.agent_version) for item in found} == {
        ("turtle", "192.0.2.1", "0.1.0")
    }


def test_key_that_somebody_wrote_by_sql_waits_too(site):
    """It came with no join, so it stands first."""
    site.announce("planned", OTHER_MAC)
    with site.database.transaction() as tx:
        tx.change(
            "UPDATE robots SET public_key = 'k', fingerprint = 'SHA256:k' WHERE name = 'planned'"
        )
        (found,) = pending.waiting(tx)
    assert (found.robot, found.hostname, found.fingerprint) == ("planned", "", "SHA256:k")


def test_forgiven_key_may_ask_again(site):
    """The log says who let it."""
    name = site.ask(OTHER_MAC, OTHER_KEY).robot
    with site.database.transaction() as tx:
        robot_service.reject(tx, ADMIN, name, "SHA256:b")
        (rejected,) = pending.rejected(tx)
        assert (rejected.robot, rejected.mac, rejected.rejected_by) == (name, OTHER_MAC, "root")
        assert pending.forgive(tx, ADMIN, rejected.id) == rejected
        assert pending.rejected(tx) == []
        with pytest.raises(RecordMissingError):
            pending.forgive(tx, ADMIN, rejected.id)
    assert site.ask(OTHER_MAC, OTHER_KEY).code == "approval_pending"
    (event,) = site.events("key_forgiven")
    assert (event.actor, event.robot) == ("root", name)

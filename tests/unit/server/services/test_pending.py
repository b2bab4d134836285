"""Keys that wait, and those that were rejected."""

from joins import MAC, OTHER_KEY, OTHER_MAC, age
from robotether_server.db import robots
from robotether_server.identity import PublicKey

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
        found = robots.list_waiting(tx)
    assert [(item.robot, item.mac, item.fingerprint, item.reason) for item in found] == [
        ("turtle1", MAC, "SHA256:b", "mac_in_use"),
        (name, OTHER_MAC, "SHA256:c", "approval_pending"),
    ]
    assert {(item.hostname, item.address, item.agent_version) for item in found} == {
        ("turtle", "192.0.2.1", "0.1.0")
    }

"""A robot changes its key by a signature of the one that it has, and nobody else does."""

from __future__ import annotations

import pytest
from joins import KEY, MAC, OTHER_KEY, OTHER_MAC, Site
from robot_signer import RobotSigner
from robotether_server.db import Database, claims, robots
from robotether_server.problems import FieldInvalid, KeyInUse, KeyRejected, RobotDisabled
from robotether_server.services.rotation import NAMESPACE, PreviousKey


@pytest.fixture
def old(tmp_path_factory: pytest.TempPathFactory) -> RobotSigner:
    """The key that the robot has."""
    return RobotSigner(tmp_path_factory.mktemp("old"))


@pytest.fixture
def site(database: Database, old: RobotSigner) -> Site:
    """A server on which robot sim1 is active with that key."""
    site = Site(database)
    site.announce()
    site.ask(key=old.key)
    site.set_state("sim1", "active")
    with database.transaction() as tx:
        robots.request_rotation(tx, robots.get(tx, "sim1").id)
    return site


def signed(old: RobotSigner, mac: str = MAC, line: str = KEY.line) -> PreviousKey:
    return PreviousKey(old.key.fingerprint, old.sign(NAMESPACE, f"{mac} {line}\n"))


def test_signed_key_takes_the_place_of_the_one_that_signed(site: Site, old: RobotSigner) -> None:
    """The robot stays active; asking again, as after a lost answer, changes nothing."""
    for _ in range(2):
        assert site.ask(previous=signed(old)).code == "active"
    robot = site.robot("sim1")
    assert (robot.state, robot.key, robot.rotate_requested_at) == ("active", KEY, None)
    (event,) = site.events("key_rotated")
    assert (event["robot"], event["actor"]) == ("sim1", "robot")
    assert site.ask(key=old.key).code == "mac_in_use"


@pytest.mark.parametrize("wrong", [{"mac": OTHER_MAC}, {"line": OTHER_KEY.line}])
def test_signature_over_something_else_is_refused(
    site: Site, old: RobotSigner, wrong: dict[str, str]
) -> None:
    """Another MAC or another key."""
    with pytest.raises(FieldInvalid, match="cannot use previous_key"):
        site.ask(previous=signed(old, **wrong))
    assert site.robot("sim1").key == old.key


def test_unknown_robots_signature_changes_nothing(
    site: Site, old: RobotSigner, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Under the old key's name it is refused; under its own the new key only waits."""
    stranger = RobotSigner(tmp_path_factory.mktemp("stranger"))
    forged = PreviousKey(old.key.fingerprint, signed(stranger).signature)
    with pytest.raises(FieldInvalid):
        site.ask(previous=forged)
    assert site.ask(previous=signed(stranger)).code == "mac_in_use"
    assert site.robot("sim1").key == old.key


def test_only_active_robots_change_their_key(site: Site, old: RobotSigner) -> None:
    """A disabled one is told so; one that waits goes on waiting with the key that it showed."""
    site.set_state("sim1", "disabled")
    with pytest.raises(RobotDisabled):
        site.ask(previous=signed(old))
    site.set_state("sim1", "pending")
    assert site.ask(previous=signed(old)).code == "mac_in_use"
    assert site.robot("sim1").key == old.key


def test_key_that_waited_elsewhere_is_free_for_it(site: Site, old: RobotSigner) -> None:
    """Be it this robot's claim or an unknown robot's row, as an unknown robot proves nothing."""
    assert site.ask().code == "mac_in_use"
    assert site.ask(previous=signed(old)).code == "active"
    with site.database.transaction() as tx:
        assert claims.waiting(tx) == []


def test_unknown_robots_row_with_the_new_key_goes(site: Site, old: RobotSigner) -> None:
    """It does not keep the robot from rotating."""
    site.ask(OTHER_MAC)
    assert site.ask(previous=signed(old)).code == "active"
    assert site.names() == ["sim1"]


def test_key_of_another_robot_or_a_rejected_one_is_refused(site: Site, old: RobotSigner) -> None:
    """The old key's signature does not make up for that."""
    name = site.ask(OTHER_MAC).robot
    site.set_state(name, "active")
    with pytest.raises(KeyInUse):
        site.ask(previous=signed(old))
    with site.database.transaction() as tx:
        other = robots.get(tx, name)
        claims.add_rejected(tx, other, "root")
        robots.remove(tx, other.id)
    with pytest.raises(KeyRejected):
        site.ask(previous=signed(old))

"""What a robot that shows a MAC and a key is told, and what a stranger cannot bring about."""

import dataclasses
import datetime as dt

import pytest
from joins import KEY, MAC, OTHER_KEY, OTHER_MAC, Site, age, key
from robot_signer import RobotSigner
from robotether_common.join import ROTATION_NAMESPACE, PreviousKey, rotation_message
from robotether_server.db import credentials, robots, users
from robotether_server.db import grants as db_grants
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.db.join_tokens import Place
from robotether_server.db.robots import Report
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    KeyInUseError,
    KeyRejectedError,
    MacElsewhereError,
    RobotDisabledError,
    TokenExpiredError,
    TokenInvalidError,
    TokenRequiredError,
    TokenUsedUpError,
    TooManyPendingError,
)
from robotether_server.services import grants, tokens
from robotether_server.services import robots as robot_service
from robotether_server.services.grants import Grantee, Scope
from robotether_server.services.joining import (
    MAX_UNKNOWN_PER_NETWORK,
    Answer,
    find_credential,
)

ADMIN = Source("root")


@pytest.fixture
def site(database):
    """A server where an admin approves each key."""
    return Site(database)


def reject(site, name, fingerprint):
    with site.database.transaction() as tx:
        robot_service.reject(tx, ADMIN, name, fingerprint)


@pytest.mark.parametrize("state", ["pending", "active"])
def test_second_key_of_a_mac_waits_beside_the_first(site, state):
    """The first goes on; the second learns nothing of that robot, and waits once however often it asks."""
    site.announce()
    site.set_state("sim1", "active")
    # The MAC alone proves nothing, even for a row that was set active.
    assert (site.ask().code, site.robot("sim1").state) == ("approval_pending", "pending")
    site.set_state("sim1", state)
    for _ in range(2):
        answer = site.ask(key=OTHER_KEY)
        assert (answer.code, answer.robot) == ("mac_in_use", "robot-006101")
        assert "sim1" not in answer.detail
    assert (site.robot("sim1").state, site.robot("sim1").key) == (state, KEY)
    assert site.claimed() == ["SHA256:b"]
    assert len(site.events("key_claimed")) == 1


def test_key_does_not_get_another_mac(site):
    """A cloned disk is told to make its own key, and leaves no row, be the key a robot's or a claim."""
    site.ask()
    with pytest.raises(KeyInUseError):
        site.ask(OTHER_MAC)
    site.ask(key=OTHER_KEY)
    with pytest.raises(KeyInUseError):
        site.ask(OTHER_MAC, OTHER_KEY)
    assert site.names() == ["robot-006101"]


def test_disabled_robot_is_told_how_to_come_back(site):
    """The sentence has the admin's command; to another key it does not name the robot."""
    site.announce()
    site.ask()
    site.set_state("sim1", "disabled")
    with pytest.raises(RobotDisabledError, match="robotether robot enable sim1"):
        site.ask()
    with pytest.raises(RobotDisabledError) as refused:
        site.ask(key=OTHER_KEY)
    assert "sim1" not in refused.value.detail
    assert site.claimed() == []


def test_only_so_many_may_wait(site):
    site = dataclasses.replace(site, limit=2)
    for number in range(3):
        site.announce(f"planned-{number}", f"00:1b:44:00:62:0{number}")
    first = site.ask()
    site.ask(key=OTHER_KEY)
    for mac in (MAC, OTHER_MAC):
        with pytest.raises(
            TooManyPendingError, match=r"2 already wait for approval.*robotether robot add"
        ):
            site.ask(mac, key(3))
    assert site.ask() == first
    assert site.ask("00:1b:44:00:62:00", key(4)).robot == "planned-0"


def test_one_network_leaves_ten_waiting(site):
    """Other networks, announced robots and an admin's token are not kept out by it."""
    site = dataclasses.replace(site, limit=50)
    for number in range(MAX_UNKNOWN_PER_NETWORK):
        site.unknown_robot(number, f"2001:db8::{number + 1:x}")
    with pytest.raises(
        TooManyPendingError, match="10 from 2001:db8::/64 already wait for approval"
    ):
        site.unknown_robot(90, "2001:db8::99")
    assert site.unknown_robot(0, "2001:db8::99").code == "approval_pending"
    assert site.unknown_robot(91, "2001:db8:0:1::1").code == "approval_pending"
    here = Report("turtle", "0.1.0", "2001:db8::99")
    site.announce()
    assert site.ask(report=here).code == "approval_pending"
    with pytest.raises(TooManyPendingError):
        site.ask(key=key(92), report=here)
    token = site.admins_token()
    assert site.ask(OTHER_MAC, OTHER_KEY, report=here, token=token).code == "active"


def test_unknown_robots_and_claims_make_room_after_a_day(site):
    """The next join removes what nobody wanted; an announced robot waits for ever, and a rejected key is remembered."""
    name = site.ask(OTHER_MAC, key(9)).robot
    reject(site, name, key(9).fingerprint)
    site.announce()
    site.ask()
    site.ask(key=OTHER_KEY)
    site.unknown_robot(1)
    with site.database.transaction() as tx:
        age(tx, 23)
    site.unknown_robot(2)
    with site.database.transaction() as tx:
        age(tx, 2)
    site.unknown_robot(3)
    assert site.names() == ["robot-010002", "robot-010003", "sim1"]
    assert site.claimed() == []
    with pytest.raises(KeyRejectedError):
        site.ask(OTHER_MAC, key(9))


def test_same_last_digits_make_a_longer_name(site):
    """Two unknown robots never want one name, and there is always another."""
    assert site.ask().robot == "robot-006101"
    assert site.ask("00:1b:54:00:61:01", key(1)).robot == "robot-4006101"
    for number, digits in enumerate(("44006101", "b44006101", "1b44006101", "41b44006101")):
        site.announce(f"robot-{digits}", f"00:1b:44:00:99:0{number}")
    site.announce("robot-041b44006101", "00:1b:44:00:99:09")
    assert site.ask("04:1b:44:00:61:01", key(2)).robot == "robot-041b44006101-2"


def test_known_key_changes_nothing(site):
    """MAC and public key are no secrets, so a join with both tells nothing new about the robot."""
    for state in ("pending", "active"):
        site.set_state(site.ask().robot, state)
        with site.database.transaction() as tx:
            before = tx.row("SELECT * FROM robots")
        site.ask(report=Report("evil", "6.6.6", "203.0.113.66"))
        with site.database.transaction() as tx:
            assert tx.row("SELECT * FROM robots") == before


@pytest.mark.parametrize("policy", ["approve", "first-key", "token-only"])
def test_rejected_key_is_told_so(site, policy):
    site.ask()
    token = site.admins_token()
    reject(site, "robot-006101", "SHA256:a")
    site = dataclasses.replace(site, policy=policy)
    for given in (None, token):
        with pytest.raises(KeyRejectedError, match="make a new key"):
            site.ask(token=given)
    assert site.ask(key=OTHER_KEY, token=token).code == "active"


def test_first_key_of_an_announced_robot_gets_in(site):
    """The next one, of a claim too, waits; a later join says the same, whatever token the image still has."""
    site = dataclasses.replace(site, policy="first-key")
    site.announce()
    for token in (None, "rj_deleted-since"):
        assert site.ask(token=token) == Answer("sim1", "active")
    assert site.ask(key=OTHER_KEY).code == "mac_in_use"
    assert site.ask(OTHER_MAC, key(2)).code == "approval_pending"
    assert [event.actor for event in site.events("robot_approved")] == ["robot"]
    with site.database.transaction() as tx:
        robot_service.rekey(tx, ADMIN, "sim1")
    assert site.ask(key=OTHER_KEY).code == "approval_pending"
    assert (site.robot("sim1").key, site.claimed()) == (OTHER_KEY, [])


def test_token_only_lets_nobody_wait(site):
    """An active robot goes on; announced rows and second keys need a token as well."""
    site.announce("old", OTHER_MAC)
    site.ask(OTHER_MAC, key(9))
    site.set_state("old", "active")
    site.announce()
    site = dataclasses.replace(site, policy="token-only")
    assert site.ask(OTHER_MAC, key(9)).code == "active"
    for mac in (MAC, OTHER_MAC, "00:1b:44:00:61:03"):
        with pytest.raises(TokenRequiredError, match="robotether robot invite"):
            site.ask(mac)
    assert site.ask(token=site.join_token(1)).code == "active"


def test_admins_token_beats_a_key_that_only_waits(site):
    """Who joined first in a robot's name does not keep it out; an approved key stays."""
    site.ask()
    token = site.admins_token()
    answer = site.ask(key=OTHER_KEY, token=token)
    assert (answer.code, site.robot(answer.robot).key) == ("active", OTHER_KEY)
    assert site.ask(token=token).code == "mac_in_use"
    assert site.robot(answer.robot).key == OTHER_KEY
    (event,) = site.events("robot_approved")
    assert (event.actor, event.details["by"]) == ("root", "admin")


def test_key_that_an_unknown_robot_showed_first_is_free_for_its_robot(site):
    """A public key is no secret: whoever shows it under another MAC does not keep the robot out."""
    site.announce()
    site.ask(OTHER_MAC)
    token = site.admins_token()
    assert site.ask(token=token) == Answer("sim1", "active")
    assert site.names() == ["sim1"]
    site.ask(key=OTHER_KEY)
    assert site.ask(OTHER_MAC, OTHER_KEY, token=token).code == "active"
    assert site.claimed() == []


def test_join_token_lets_as_many_in_as_it_says(site):
    """A robot that asks again uses none up, and neither does one that is not let in."""
    token = site.join_token(2)
    for _ in range(2):
        assert site.ask(token=token).code == "active"
    assert site.used() == 1
    assert site.ask(key=key(5), token=token).code == "mac_in_use"
    with pytest.raises(KeyInUseError):
        site.ask("00:1b:44:00:61:09", token=token)
    assert site.used() == 1
    assert site.ask(OTHER_MAC, OTHER_KEY, token=token).code == "active"
    with pytest.raises(TokenUsedUpError, match="was good for 2 robots"):
        site.ask("00:1b:44:00:61:09", key(6), token=token)
    assert len(site.names()) == 2
    assert site.ask(token=token).code == "active"
    event, _ = site.events("robot_approved")
    assert event.actor == "robot"
    assert (event.details["by"], event.details["token"]) == ("join token", "lab")


def test_token_puts_a_robot_in_its_place(site):
    site.announce("sim2", OTHER_MAC)
    ends_at = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
    crew = Grantee("group", "crew")
    with site.database.transaction() as tx:
        for name in ("lab", "yard"):
            grants.add_collection(tx, ADMIN, SITES, name)
        grants.add_collection(tx, ADMIN, GROUPS, "crew")
        grants.place_robot(tx, ADMIN, "sim2", "yard")
        grants.give(tx, ADMIN, crew, Scope("robot", "sim2"), "observe")
        robot_service.change_settings(
            tx, ADMIN, "sim2", lambda _present: {"region": "us", "shell_user": "pi"}
        )
        place = Place("lab", "crew", "eu")
        token = tokens.create_join_token(tx, ADMIN, "lab", 2, ends_at, place=place)
    assert site.ask(token=token).region == "eu"
    assert site.ask(OTHER_MAC, OTHER_KEY, token=token).region == "us"
    with site.database.transaction() as tx:
        new, announced = (robots.get(tx, name) for name in ("robot-006101", "sim2"))
        given = {(item.robot, item.group, item.level) for item in db_grants.list_all(tx)}
    assert (new.site, new.settings) == ("lab", {"region": "eu"})
    assert (announced.site, announced.settings["region"]) == ("yard", "us")
    assert given == {("robot-006101", "crew", "drive"), ("sim2", "crew", "observe")}


def test_token_does_not_undo_what_an_admin_did(site):
    """A robot that was removed waits as any unknown robot, though its image still has the token."""
    token = site.join_token(9)
    site.ask(token=token)
    with site.database.transaction() as tx:
        robot_service.remove(tx, ADMIN, "robot-006101")
    assert site.ask(token=token).code == "approval_pending"
    assert site.used() == 1
    with pytest.raises(TokenUsedUpError, match="an admin has undone that"):
        dataclasses.replace(site, policy="token-only").ask(token=token)


def test_token_expires_by_the_clock_of_the_database(site):
    """The database's clock decides, as it does when the token is used."""
    token = site.join_token(1, 1)
    with site.database.transaction() as tx:
        assert find_credential(tx, token)
        tx.change("SET timestamp = UNIX_TIMESTAMP() + 7200")
        with pytest.raises(TokenExpiredError):
            find_credential(tx, token)


def test_wrong_tokens_are_told_apart(site):
    over = site.join_token(1, -0.1)
    with pytest.raises(TokenExpiredError, match="it expired at"):
        site.ask(token=over)
    for wrong in ("rj_nobodys", "rt_nobodys", "nobodys"):
        with pytest.raises(TokenInvalidError):
            site.ask(token=wrong)
    with site.database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        of_a_user = credentials.create_token(tx, users.get(tx, "ann"), "a", None)
    with pytest.raises(GrantMissingError, match="must be an admin's"):
        site.ask(token=of_a_user)
    assert site.names() == []


@pytest.mark.parametrize(
    ("wish", "name"),
    [("turtle", "turtle"), *((wish, "robot-006101") for wish in ("taken", "No Name", "localhost"))],
)
def test_requested_name_is_given_with_a_token(site, wish, name):
    site.announce("taken", "00:1b:44:00:61:09")
    token = site.admins_token()
    assert site.ask(OTHER_MAC, OTHER_KEY, name=wish).robot == "robot-006102"
    assert site.ask(name=wish, token=token).robot == name
    assert site.ask("00:1b:44:00:61:09", key(3), name=wish, token=token).robot == "taken"


def test_local_macs_are_for_announced_robots(site):
    local = "02:42:ac:11:00:02"
    for token in (None, site.admins_token()):
        with pytest.raises(FieldInvalidError, match="locally administered"):
            site.ask(local, token=token)
    assert dataclasses.replace(site, local=True).ask(local).code == "approval_pending"
    site.announce(mac="02:42:ac:11:00:03")
    assert site.ask("02:42:ac:11:00:03", OTHER_KEY).robot == "sim1"


def test_robot_that_lost_its_mac_stays_itself(site, admin_database):
    """Once a day the log says so; while the robot is online, who asks is a copy."""
    site.announce()
    site.ask()
    site.set_state("sim1", "active")
    for _ in range(2):
        assert site.ask(mac_present=False).code == "active"
    assert [event.robot for event in site.events("mac_changed")] == ["sim1"]
    with admin_database.transaction() as tx:
        tx.change("INSERT INTO robot_sessions (robot_id, address) SELECT id, '::1' FROM robots")
    with pytest.raises(MacElsewhereError, match="copy of that robot's disk"):
        site.ask(mac_present=False)
    assert site.ask().code == "active"


def test_robot_with_a_new_network_card_is_found_by_its_key(rotating_site):
    """It goes on with the card's MAC in its row, and after the old card went to another robot."""
    with rotating_site.database.transaction() as tx:
        robot_service.set_mac(tx, ADMIN, "sim1", OTHER_MAC)
    with pytest.raises(KeyInUseError):
        rotating_site.ask(key=OLD.key)
    assert rotating_site.ask(key=OLD.key, mac_present=False).robot == "sim1"
    assert rotating_site.ask(key=OTHER_KEY).code == "approval_pending"
    for key_, previous in ((OLD.key, None), (KEY, signed()), (KEY, signed())):
        asked = rotating_site.ask(key=key_, previous=previous, mac_present=False)
        assert (asked.robot, asked.code) == ("sim1", "active")
    assert (rotating_site.robot("sim1").key, rotating_site.robot("sim1").mac) == (KEY, OTHER_MAC)


OLD = RobotSigner()


@pytest.fixture
def rotating_site(database):
    """A server on which robot sim1 is active with that key."""
    rotating_site = Site(database)
    rotating_site.announce()
    rotating_site.ask(key=OLD.key)
    rotating_site.set_state("sim1", "active")
    with database.transaction() as tx:
        robots.request_rotation(tx, robots.get(tx, "sim1").id)
    return rotating_site


def signed(signer=OLD, mac=MAC, line=KEY.line):
    signature = signer.sign(ROTATION_NAMESPACE, rotation_message(mac, line))
    return PreviousKey(signer.key.fingerprint, signature)


def test_signed_key_takes_the_place_of_the_one_that_signed(rotating_site):
    """The robot stays active; asking again, as after a lost answer, changes nothing."""
    for _ in range(2):
        assert rotating_site.ask(previous=signed()).code == "active"
    robot = rotating_site.robot("sim1")
    assert (robot.state, robot.key, robot.rotate_requested_at) == ("active", KEY, None)
    (event,) = rotating_site.events("key_rotated")
    assert (event.robot, event.actor) == ("sim1", "robot")
    assert rotating_site.ask(key=OLD.key).code == "mac_in_use"


@pytest.mark.parametrize("wrong", [{"mac": OTHER_MAC}, {"line": OTHER_KEY.line}])
def test_signature_over_something_else_is_refused(rotating_site, wrong):
    with pytest.raises(FieldInvalidError, match="cannot use previous_key"):
        rotating_site.ask(previous=signed(**wrong))
    assert rotating_site.robot("sim1").key == OLD.key


def test_unknown_robots_signature_changes_nothing(rotating_site):
    """Under the old key's name it is refused; under its own the new key only waits."""
    stranger = RobotSigner()
    forged = PreviousKey(OLD.key.fingerprint, signed(stranger).signature)
    with pytest.raises(FieldInvalidError):
        rotating_site.ask(previous=forged)
    assert rotating_site.ask(previous=signed(stranger)).code == "mac_in_use"
    assert rotating_site.robot("sim1").key == OLD.key


def test_only_active_robots_change_their_key(rotating_site):
    """A disabled one is told so; one that waits goes on waiting with the key that it showed."""
    rotating_site.set_state("sim1", "disabled")
    with pytest.raises(RobotDisabledError):
        rotating_site.ask(previous=signed())
    rotating_site.set_state("sim1", "pending")
    assert rotating_site.ask(previous=signed()).code == "mac_in_use"
    assert rotating_site.robot("sim1").key == OLD.key


@pytest.mark.parametrize("mac", [MAC, OTHER_MAC])
def test_key_that_waited_elsewhere_is_free_for_it(rotating_site, mac):
    """Be it this robot's claim or an unknown robot's row, as an unknown robot proves nothing."""
    rotating_site.ask(mac)
    assert rotating_site.ask(previous=signed()).code == "active"
    assert (rotating_site.claimed(), rotating_site.names()) == ([], ["sim1"])


def test_key_of_another_robot_or_a_rejected_one_is_refused(rotating_site):
    name = rotating_site.ask(OTHER_MAC).robot
    rotating_site.set_state(name, "active")
    with pytest.raises(KeyInUseError):
        rotating_site.ask(previous=signed())
    with rotating_site.database.transaction() as tx:
        other = robots.get(tx, name)
        robots.reject_claim(tx, robots.add_claim(tx, other, other.key, other.report), name, "root")
        robots.remove(tx, other.id)
    with pytest.raises(KeyRejectedError):
        rotating_site.ask(previous=signed())

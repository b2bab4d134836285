"""What a robot that shows a MAC and a key is told."""

from __future__ import annotations

import json

import pytest
from robotether_server.problems import (
    KeyInUse,
    MacInUse,
    RobotDisabled,
    StoreUnavailable,
    TooManyPending,
)
from robotether_server.ssh_keys import PublicKey
from robotether_server.store import Database, robots, users
from robotether_server.store.robots import Report, Robot
from robotether_server.web.joining import STRANGERS_PER_NETWORK, Request, join

MAC = "02:00:00:00:61:01"
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:a")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:b")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")


def ask(
    database: Database,
    mac: str = MAC,
    key: PublicKey = KEY,
    *,
    limit: int = 3,
    report: Report = REPORT,
    approver: str | None = None,
) -> Robot:
    with database.transaction() as tx:
        vouching = users.get(tx, approver) if approver else None
        return join(tx, Request(mac, key, report, vouching), limit)


def stranger(database: Database, number: int, address: str, limit: int = 50) -> Robot:
    """An unknown robot's join."""
    key = PublicKey(f"ssh-ed25519 {number}", f"SHA256:{number}")
    report = Report("turtle", "0.1.0", address)
    return ask(database, f"02:00:00:01:00:{number:02x}", key, limit=limit, report=report)


@pytest.fixture
def root(database: Database) -> str:
    """The name of an admin."""
    with database.transaction() as tx:
        users.add(tx, "root", "x", "admin")
    return "root"


def set_state(database: Database, name: str, state: str) -> None:
    with database.transaction() as tx:
        tx.change("UPDATE robots SET state = %s WHERE name = %s", (state, name))


def test_row_of_an_admin_takes_the_first_key_and_waits(database: Database) -> None:
    """The admin's name stays; the MAC alone proves nothing, even for a row that was set active."""
    for state in ("pending", "active"):
        with database.transaction() as tx:
            tx.change("DELETE FROM robots")
            robots.add(tx, MAC, "sim1")
        set_state(database, "sim1", state)
        robot = ask(database)
        assert (robot.name, robot.state, robot.fingerprint) == ("sim1", "pending", "SHA256:a")


def test_approved_robot_stays_active(database: Database) -> None:
    """Every later join with the same key says so."""
    name = ask(database).name
    set_state(database, name, "active")
    assert ask(database).state == "active"


@pytest.mark.parametrize("state", ["pending", "active"])
def test_another_key_does_not_get_the_mac(database: Database, state: str) -> None:
    """Whether the row's own key is approved or not."""
    set_state(database, ask(database).name, state)
    with pytest.raises(MacInUse, match="robot robot-006101 has it, with another key"):
        ask(database, key=OTHER_KEY)


def test_key_does_not_get_another_mac(database: Database) -> None:
    """A cloned disk is told to make its own key, and leaves no row."""
    ask(database)
    with pytest.raises(KeyInUse):
        ask(database, mac="02:00:00:00:61:02")
    with database.transaction() as tx:
        assert len(robots.list_all(tx)) == 1


def test_disabled_robot_is_told_how_to_come_back(database: Database) -> None:
    """The sentence has the admin's command."""
    set_state(database, ask(database).name, "disabled")
    with pytest.raises(RobotDisabled, match="robotether robot enable robot-006101"):
        ask(database)


def test_only_so_many_unknown_robots_may_wait(database: Database) -> None:
    """Those who wait already go on waiting."""
    first = ask(database, limit=1)
    with pytest.raises(TooManyPending):
        ask(database, mac="02:00:00:00:61:02", key=OTHER_KEY, limit=1)
    assert ask(database, limit=1) == first


def test_rows_of_an_admin_are_no_unknown_robots(database: Database) -> None:
    """A fleet that was entered beforehand does not use the waiting places up."""
    with database.transaction() as tx:
        for number in range(3):
            robots.add(tx, f"02:00:00:00:62:0{number}", f"planned-{number}")
    assert ask(database, limit=1).state == "pending"


def test_same_robot_that_asks_twice_at_once_is_told_to_try_again(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who comes second finds the row that the other request made meanwhile."""
    ask(database)
    monkeypatch.setattr(robots, "find_by_mac", lambda *_: None)
    with pytest.raises(StoreUnavailable, match="try again"):
        ask(database)


def test_same_last_digits_make_a_longer_name(database: Database) -> None:
    """Two unknown robots never want one name."""
    assert ask(database).name == "robot-006101"
    other = ask(
        database, mac="02:00:00:11:61:01".replace("11", "00").replace("02", "06"), key=OTHER_KEY
    )
    assert other.name == "robot-0006101"


def test_known_key_changes_nothing(database: Database) -> None:
    """MAC and public key are no secrets, so a join with both tells nothing new about the robot."""
    for state in ("pending", "active"):
        set_state(database, ask(database).name, state)
        with database.transaction() as tx:
            before = tx.row("SELECT * FROM robots")
        ask(database, report=Report("evil", "6.6.6", "203.0.113.66"))
        with database.transaction() as tx:
            assert tx.row("SELECT * FROM robots") == before


def test_one_network_leaves_ten_strangers_waiting(database: Database, root: str) -> None:
    """Other networks, announced robots and an admin's token are not kept out by it."""
    for number in range(STRANGERS_PER_NETWORK):
        stranger(database, number, f"2001:db8::{number + 1:x}")
    with pytest.raises(TooManyPending, match="10 from 2001:db8::/64 wait for approval"):
        stranger(database, 90, "2001:db8::99")
    assert stranger(database, 0, "2001:db8::99").state == "pending"
    assert stranger(database, 91, "2001:db8:0:1::1").state == "pending"
    here = Report("turtle", "0.1.0", "2001:db8::99")
    with database.transaction() as tx:
        robots.add(tx, MAC, "announced")
    assert ask(database, report=here).state == "pending"
    other = ask(database, "02:00:00:00:61:02", OTHER_KEY, report=here, approver=root)
    assert other.state == "active"


def test_all_networks_together_have_a_limit(database: Database) -> None:
    """The sentence says how a robot gets in all the same."""
    for number in range(3):
        stranger(database, number, f"192.0.2.{number}", limit=3)
    with pytest.raises(TooManyPending, match=r"3 wait for approval already.*robotether robot add"):
        stranger(database, 3, "192.0.2.3", limit=3)


def test_strangers_make_room_after_a_day(database: Database) -> None:
    """The next join removes those that nobody wanted; an announced robot waits for ever."""
    with database.transaction() as tx:
        robots.add(tx, MAC, "announced")
    ask(database)
    stranger(database, 1, "192.0.2.1")
    with database.transaction() as tx:
        tx.change("UPDATE robots SET joined_at = joined_at - INTERVAL 23 HOUR")
    stranger(database, 2, "192.0.2.2")
    with database.transaction() as tx:
        tx.change("UPDATE robots SET joined_at = joined_at - INTERVAL 2 HOUR")
    stranger(database, 3, "192.0.2.3", limit=2)
    with database.transaction() as tx:
        names = [seen.robot.name for seen in robots.list_all(tx)]
    assert names == ["announced", "robot-010002", "robot-010003"]


def test_removed_robot_may_come_back_as_a_stranger(database: Database) -> None:
    """With its key, which nobody has any more."""
    with database.transaction() as tx:
        robots.add(tx, MAC, "sim1")
    ask(database)
    with database.transaction() as tx:
        robots.remove(tx, robots.get(tx, "sim1").id)
    assert (ask(database).name, ask(database).state) == ("robot-006101", "pending")


def test_rekeyed_robot_takes_the_next_key(database: Database) -> None:
    """It keeps its name, and waits."""
    name = ask(database).name
    set_state(database, name, "active")
    with pytest.raises(MacInUse, match=f"robotether robot rekey {name}"):
        ask(database, key=OTHER_KEY)
    with database.transaction() as tx:
        robots.forget_key(tx, robots.get(tx, name).id)
    robot = ask(database, key=OTHER_KEY)
    assert (robot.name, robot.state, robot.fingerprint) == (name, "pending", "SHA256:b")


def test_admins_token_beats_a_key_that_only_waits(database: Database, root: str) -> None:
    """Who joined first in a robot's name does not keep it out; an approved key stays."""
    ask(database)
    robot = ask(database, key=OTHER_KEY, approver=root)
    assert (robot.state, robot.fingerprint) == ("active", "SHA256:b")
    with pytest.raises(MacInUse):
        ask(database, approver=root)


def test_admins_token_approves(database: Database, root: str) -> None:
    """And the audit log says who it was, and which key."""
    assert ask(database, limit=0, approver=root).state == "active"
    with database.transaction() as tx:
        row = tx.row("SELECT actor, details FROM audit_events WHERE kind = 'robot_approved'")
    assert row is not None
    assert row["actor"] == "root"
    assert json.loads(row["details"])["fingerprint"] == "SHA256:a"

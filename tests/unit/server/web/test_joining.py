"""What a robot that shows a MAC and a key is told."""

from __future__ import annotations

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
from robotether_server.web.joining import Request, join

MAC = "02:00:00:00:61:01"
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:a")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:b")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")


def ask(database: Database, mac: str = MAC, key: PublicKey = KEY, limit: int = 3) -> Robot:
    with database.transaction() as tx:
        return join(tx, Request(mac, key, REPORT, None), limit)


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


def test_admins_token_approves(database: Database) -> None:
    """And the audit log says who it was."""
    with database.transaction() as tx:
        users.add(tx, "root", "x", "admin")
        request = Request(MAC, KEY, REPORT, users.get(tx, "root"))
        assert join(tx, request, 0).state == "active"
        row = tx.row("SELECT actor FROM audit_events WHERE kind = 'robot_approved'")
    assert row == {"actor": "root"}

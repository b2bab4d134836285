"""Robots and their keys in the real database."""

import datetime as dt
from contextlib import suppress

import pytest
from allotment import mac, pair_owners
from granted import give
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from robotether_server import identity
from robotether_server.db import robots, seen_robots, users
from robotether_server.db.robots import Report
from robotether_server.identity import PublicKey
from robotether_server.problems import (
    FieldInvalidError,
    RecordExistsError,
    RecordRefusedError,
)

MAC = "00:1b:44:11:3a:b7"
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:abc")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")


# The column's; a trigger never sees a longer text, which only a space in front of a whole MAC makes.
MAX_IN_SQL_LENGTH = 17


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.one_of(
        st.from_regex(r"[0-9a-fA-F]{1,4}([:.-]?[0-9a-fA-Fg]{2,4}){1,5}", fullmatch=True),
        st.from_regex(r" ?[0-9a-f]{1,2}(:[0-9a-f]{1,2}){5}", fullmatch=True),
        st.from_regex(r"[0-3f]{12} ?", fullmatch=True),
    )
)
@example("0:0:0:0:0:0")
@example("ffffffffffff")
@example("01:00:5e:00:00:fb")
@example("001b.4411.3ab7")
@example("0-1B-44-11-3A-B7")
def test_python_and_sql_agree_about_macs(database, text):
    """The twin in Python accepts and makes exactly what the triggers do, of a new robot and of one that is changed."""
    try:
        expected = identity.normalise_mac(text)
    except FieldInvalidError:
        expected = None
    if len(text.rstrip()) > MAX_IN_SQL_LENGTH:
        expected = None
    for write in (
        lambda tx: robots.add(tx, text, "a"),
        lambda tx: robots.set_mac(tx, robots.add(tx, mac(1), "a"), text),
    ):
        written = None
        with suppress(RecordRefusedError), database.transaction() as tx:
            tx.change("DELETE FROM robots")
            write(tx)
            written = robots.get(tx, "a").mac
        assert written == expected


def add_with_ports(tx, number, name, ros, video):
    return tx.insert(
        "INSERT INTO robots (mac, name, ros_port, video_port) VALUES (%s, %s, %s, %s)",
        (mac(number), name, ros, video),
    )


def test_ports_that_were_named_are_kept_and_not_allotted(database, admin_database):
    """Somebody's own choice of ports holds both pairs that it touches."""
    with database.transaction() as tx:
        chosen = add_with_ports(tx, 1, "chosen", 20001, 20004)
        robots.add(tx, mac(2), "next")
        assert robots.get(tx, "chosen").video_port == 20004
        assert robots.get(tx, "next").ros_port == 20002
    pairs = [port for port, owner in pair_owners(admin_database).items() if owner == chosen]
    assert pairs == [20000, 20004]


def test_ports_that_cannot_be_are_refused(database):
    with database.transaction() as tx:
        robots.add(tx, mac(1), "a")
        wrong = ((20001, 30000), (20000, 30000), (30000, None), (30000, 30000), (80, 30000))
        for ros, video in wrong:
            with pytest.raises((RecordRefusedError, RecordExistsError)):
                add_with_ports(tx, 2, "b", ros, video)


def test_rotated_key_keeps_the_one_before(database):
    new = PublicKey("ssh-ed25519 BBBB", "SHA256:new")
    with database.transaction() as tx:
        robot_id = robots.add(tx, MAC, "a")
        robots.set_key(tx, robot_id, KEY, REPORT)
        robots.request_rotation(tx, robot_id)
        assert robots.get(tx, "a").rotate_requested_at is not None
        robots.rotate_key(tx, robot_id, new)
        robot = robots.get(tx, "a")
        assert (robot.key, robot.report, robot.rotate_requested_at) == (new, REPORT, None)
        assert previous(tx) == KEY.fingerprint
        robots.forget_key(tx, robot_id)
        assert previous(tx) is None
        robots.set_key(tx, robot_id, KEY, REPORT)
        robots.rotate_key(tx, robot_id, new)
        robots.set_key(tx, robot_id, KEY, REPORT)
        assert previous(tx) is None


def previous(tx):
    row = tx.row("SELECT previous_fingerprint FROM robots")
    return row["previous_fingerprint"]


def add_unknown(tx, number, name):
    robot_id = robots.add(tx, mac(number), name, unknown=True)
    robots.set_key(tx, robot_id, PublicKey("ssh-ed25519 A", f"SHA256:{number}"), REPORT)
    return robot_id


def test_only_old_unknown_robots_are_removed(database, admin_database):
    """Rows of admins, approved robots, those with a grant and newer ones stay; the ports are free again."""
    with database.transaction() as tx:
        robots.set_key(tx, robots.add(tx, MAC, "announced"), KEY, REPORT)
        ids = {name: add_unknown(tx, n, name) for n, name in enumerate(("old", "known", "granted"))}
        robots.set_state(tx, ids["known"], "active")
        robots.set_state(tx, ids["known"], "pending")
        give(tx, users.add(tx, "ann", "x", "user"), ids["granted"], "drive")
        tx.change("UPDATE robots SET joined_at = joined_at - INTERVAL 25 HOUR")
        add_unknown(tx, 9, "new")
        robots.remove_unknown(tx, dt.datetime.now(dt.UTC) - dt.timedelta(hours=24))
        names = {seen.robot.name for seen in seen_robots.list_all(tx)}
    assert names == {"announced", "known", "granted", "new"}
    assert ids["old"] not in pair_owners(admin_database).values()

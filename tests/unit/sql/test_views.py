"""What sshd and the relay are told through their views and their procedure."""

import datetime as dt
import json

import pytest
from granted import give
from robotether_server.db import Database, credentials, migrate, robots, users
from robotether_server.db.robots import Report
from robotether_server.identity import PublicKey

KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:abc")
HOUR = dt.timedelta(hours=1)


@pytest.fixture
def keylookup(mariadb):
    """The database as sshd's lookup sees it."""
    return Database(mariadb.settings("keylookup"))


def version(relay_database):
    with relay_database.transaction() as tx:
        return tx.row("SELECT version FROM relay_changes")["version"]


@pytest.mark.parametrize(("state", "found"), [("active", 1), ("pending", 0), ("disabled", 0)])
def test_only_active_robots_may_open_a_tunnel(database, keylookup, state, found):
    """A key of a robot that waits or is disabled is as good as unknown."""
    with database.transaction() as tx:
        robot_id = robots.add(tx, "02:00:00:00:00:01", "a")
        robots.set_key(tx, robot_id, KEY, Report("turtle", "0.1.0", "192.0.2.1"))
        robots.set_state(tx, robot_id, state)
        robots.set_shell(tx, robot_id, on=True)
    with keylookup.transaction() as tx:
        rows = tx.rows("SELECT * FROM tunnel_keys WHERE fingerprint = %s", (KEY.fingerprint,))
    assert len(rows) == found
    assert [(row["robot_id"], row["ros_port"], row["shell_port"]) for row in rows] == [
        (robot_id, 20000, 24000)
    ] * found


def test_rights_that_hold_include_the_admins(database, relay_database):
    """Every admin manages every robot; a disabled user has no right left."""
    with database.transaction() as tx:
        ids = {name: users.add(tx, name, "x", "user") for name in ("ann", "bob")}
        ids["root"] = users.add(tx, "root", "x", "admin")
        first, second = (robots.add(tx, f"02:00:00:00:00:0{n}", f"r{n}") for n in (1, 2))
        give(tx, ids["ann"], first, "drive")
        give(tx, ids["bob"], first, "drive")
        give(tx, ids["root"], first, "observe")
        users.set_disabled(tx, ids["bob"], disabled=True)
    with relay_database.transaction() as tx:
        rows = tx.rows("SELECT * FROM relay_grants")
    assert {(row["user_id"], row["robot_id"], row["level"]) for row in rows} == {
        (ids["ann"], first, "drive"),
        (ids["root"], first, "manage"),
        (ids["root"], second, "manage"),
    }
    assert len(rows) == 3


def test_only_valid_logins_and_tokens_of_enabled_users(database, relay_database):
    """What is over, or belongs to a disabled user, is not there."""
    past = dt.datetime.now(dt.UTC) - HOUR
    with database.transaction() as tx:
        for name in ("ann", "bob"):
            users.add(tx, name, "x", "user")
            user = users.get(tx, name)
            credentials.create_login(tx, user, "192.0.2.1", HOUR)
            credentials.create_login(tx, user, "192.0.2.1", -HOUR)
            credentials.create_token(tx, user, "endless", None)
            credentials.create_token(tx, user, "over", past)
        tx.change("UPDATE users SET disabled = TRUE WHERE name = 'bob'")
    with relay_database.transaction() as tx:
        for view in ("relay_logins", "relay_tokens"):
            rows = tx.rows("SELECT * FROM " + view)
            assert [(row["user_name"], row["role"]) for row in rows] == [("ann", "user")]


def test_change_that_commits_late_is_seen(database, relay_database):
    """An older moment that commits after a newer one still changes the version."""
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:01", "early")
        robots.add(tx, "02:00:00:00:00:02", "late")
    with database.transaction() as slow:
        slow.change("UPDATE robots SET state = 'active' WHERE name = 'early'")
        with database.transaction() as quick:
            quick.change("UPDATE robots SET state = 'active' WHERE name = 'late'")
        between = version(relay_database)
    assert version(relay_database) != between


ADDRESS = "192.0.2.9"


def refuse(keylookup, fingerprint, address=ADDRESS):
    with keylookup.transaction() as tx:
        tx.change("CALL record_refused_key(%s, %s)", (fingerprint, address))


def refused_lines(database):
    with database.transaction() as tx:
        rows = tx.rows(
            "SELECT details FROM audit_events WHERE kind = 'key_refused' AND actor = 'sshd' ORDER BY id"
        )
    return [json.loads(row["details"]) for row in rows]


def test_refused_key_leaves_one_line_an_hour(database, admin_database, keylookup):
    """A robot that keeps trying is counted there, from wherever; an hour later it has another line."""
    with keylookup.transaction() as tx:
        for fingerprint in ("SHA256:a", "SHA256:a", "SHA256:b"):
            tx.change("CALL record_refused_key(%s, %s)", (fingerprint, ADDRESS))
    refuse(keylookup, "SHA256:a", "198.51.100.1")
    refuse(keylookup, "SHA256:c", "")
    assert refused_lines(database) == [
        {"fingerprint": "SHA256:a", "more": 2},
        {"fingerprint": "SHA256:b"},
        {"fingerprint": "SHA256:c"},
    ]
    with admin_database.transaction() as tx:
        tx.change("UPDATE audit_events SET at = at - INTERVAL 61 MINUTE")
    refuse(keylookup, "SHA256:a")
    assert refused_lines(database)[3:] == [{"fingerprint": "SHA256:a"}]


@pytest.mark.parametrize("address", [ADDRESS, "2001:db8:0:1::{}"])
def test_a_network_with_many_keys_hides_no_others(database, keylookup, address):
    """Its ten lines an hour say how many there were; a /64 of IPv6 is one network."""
    for number in range(15):
        refuse(keylookup, f"SHA256:{number}", address.format(number))
    refuse(keylookup, "SHA256:robot", "198.51.100.1")
    lines = refused_lines(database)
    assert [line["fingerprint"] for line in lines] == [
        *(f"SHA256:{number}" for number in range(10)),
        "SHA256:robot",
    ]
    assert [line.get("more") for line in lines] == [None] * 9 + [5, None]


def test_many_networks_leave_sixty_lines_an_hour(database, keylookup):
    """Somebody with many addresses cannot fill the disk, and the last line counts what has none."""
    for number in range(65):
        refuse(keylookup, f"SHA256:{number}", f"192.0.2.{number}")
    lines = refused_lines(database)
    assert len(lines) == 60
    assert lines[-1] == {"fingerprint": "SHA256:59", "elsewhere": 5}


def test_refused_keys_are_kept_for_a_month(database, admin_database, keylookup):
    """Refused keys end after a month even if all else is kept for ever."""
    for days in (31, 29):
        refuse(keylookup, f"SHA256:{days}")
        with admin_database.transaction() as tx:
            tx.change(
                "UPDATE audit_events SET at = at - INTERVAL %s DAY ORDER BY id DESC LIMIT 1",
                (days,),
            )
    with admin_database.transaction() as tx:
        migrate.set_audit_days(tx, 0)
        tx.change("CALL prune_history()")
    assert refused_lines(database) == [{"fingerprint": "SHA256:29"}]

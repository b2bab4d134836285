"""The rights that hold, by users and groups, robots, sites and all, with and without an end."""

import datetime as dt
import itertools

import pytest
from robotether_server.db import Database, fleet, grants, robots, seen_robots, users
from robotether_server.db.grants import GROUPS, SITES, Pair
from robotether_server.db.robots import Report
from robotether_server.identity import PublicKey
from robotether_server.problems import RecordRefusedError

HOUR = dt.timedelta(hours=1)
LEVELS = ("observe", "drive", "manage")


@pytest.fixture
def ids(database):
    """Ann in the group crew, ben in none; robots a and b at the site lab, c at none."""
    with database.transaction() as tx:
        found = {name: users.add(tx, name, "x", "user") for name in ("ann", "ben")}
        found |= {"crew": GROUPS.add(tx, "crew"), "lab": SITES.add(tx, "lab")}
        grants.add_member(tx, found["crew"], found["ann"])
        for number, name in enumerate("abc"):
            found[name] = robots.add(tx, f"02:00:00:00:00:0{number}", name)
        for name in "ab":
            grants.place_robot(tx, found[name], found["lab"])
    return found


def now():
    return dt.datetime.now(dt.UTC)


def held(database):
    """What holds, by the names of user and robot."""
    with database.transaction() as tx:
        rows = tx.rows(
            "SELECT u.name AS user, r.name AS robot, g.level FROM relay_grants g "
            "JOIN users u ON u.id = g.user_id JOIN robots r ON r.id = g.robot_id"
        )
    found = {(row["user"], row["robot"]): row["level"] for row in rows}
    assert len(found) == len(rows)
    return found


def test_each_way_of_giving_reaches_what_it_says(database, ids):
    """A group's grant is its members'; a site's is for its robots now; one for all is for all."""
    with database.transaction() as tx:
        grants.put(tx, Pair(group_id=ids["crew"], site_id=ids["lab"]), "drive")
        grants.put(tx, Pair(user_id=ids["ben"], all_robots=True), "observe")
    assert held(database) == {
        ("ann", "a"): "drive",
        ("ann", "b"): "drive",
        ("ben", "a"): "observe",
        ("ben", "b"): "observe",
        ("ben", "c"): "observe",
    }
    with database.transaction() as tx:
        grants.place_robot(tx, ids["a"], None)
        grants.place_robot(tx, ids["c"], ids["lab"])
    assert {robot for user, robot in held(database) if user == "ann"} == {"b", "c"}


def test_highest_level_holds(database, ids):
    for first, second in itertools.permutations(LEVELS, 2):
        with database.transaction() as tx:
            grants.put(tx, Pair(user_id=ids["ann"], robot_id=ids["a"]), first)
            grants.put(tx, Pair(group_id=ids["crew"], all_robots=True), second)
        highest = max(first, second, key=LEVELS.index)
        assert held(database)["ann", "a"] == highest
        with database.transaction() as tx:
            seen = seen_robots.list_seen(tx, users.get(tx, "ann"))
        assert [item.level for item in seen if item.robot.name == "a"] == [highest]


def test_grant_holds_until_its_end(database, ids):
    pair = Pair(user_id=ids["ann"], robot_id=ids["a"])
    with database.transaction() as tx:
        grants.put(tx, pair, "manage", now() + HOUR)
        grants.put(tx, Pair(group_id=ids["crew"], site_id=ids["lab"]), "observe")
    assert held(database)["ann", "a"] == "manage"
    with database.transaction() as tx:
        grants.put(tx, pair, "manage", now() - HOUR)
    assert held(database)["ann", "a"] == "observe"


def test_what_is_removed_takes_its_grants_along(database, ids):
    with database.transaction() as tx:
        for pair in (
            Pair(group_id=ids["crew"], all_robots=True),
            Pair(user_id=ids["ben"], site_id=ids["lab"]),
            Pair(user_id=ids["ben"], robot_id=ids["c"]),
        ):
            grants.put(tx, pair, "manage")
        GROUPS.remove(tx, ids["crew"])
        SITES.remove(tx, ids["lab"])
        robots.remove(tx, ids["c"])
        assert grants.list_all(tx) == []
        assert robots.get(tx, "a").site is None
    assert held(database) == {}


def test_grant_of_nobody_or_for_nothing_is_refused(database, ids):
    """The database itself keeps a row from meaning all robots by mistake."""
    ann, crew = {"user_id": ids["ann"]}, {"group_id": ids["crew"]}
    robot, site = {"robot_id": ids["a"]}, {"site_id": ids["lab"]}
    for columns in ({}, ann, ann | crew | robot, ann | robot | site, robot):
        with database.transaction() as tx, pytest.raises(RecordRefusedError):
            grants.put(tx, Pair(**columns), "observe")


def test_each_change_of_rights_is_a_new_version(database, relay_database, ids):
    crew, lab, ann = ids["crew"], ids["lab"], ids["ann"]

    def later(tx):
        # As time does: without a change to updated_at.
        tx.change(
            "UPDATE grants SET expires_at = CURRENT_TIMESTAMP(6) - INTERVAL 1 SECOND, "
            "updated_at = updated_at WHERE expires_at IS NOT NULL"
        )

    changes = (
        lambda tx: grants.remove_member(tx, crew, ann),
        lambda tx: grants.add_member(tx, crew, ann),
        lambda tx: grants.place_robot(tx, ids["c"], lab),
        lambda tx: grants.put(tx, Pair(group_id=crew, site_id=lab), "drive", now() + HOUR),
        lambda tx: grants.put(tx, Pair(group_id=crew, site_id=lab), "drive", now() + 2 * HOUR),
        later,
        lambda tx: SITES.remove(tx, lab),
        lambda tx: SITES.add(tx, "lab"),
        lambda tx: GROUPS.remove(tx, crew),
    )
    seen = []
    for change in changes:
        with database.transaction() as tx:
            change(tx)
        with relay_database.transaction() as tx:
            seen.append(fleet.changes(tx).rights)
    assert len(set(seen)) == len(changes)


def test_shells_are_of_those_who_manage(mariadb, database, ids):
    """jump_keys asks the grants anew, and finds exactly what relay_grants says of shells that are on."""
    with database.transaction() as tx:
        ids["root"] = users.add(tx, "root", "x", "admin")
        for number, (state, on) in enumerate((("active", False), ("disabled", True)), 7):
            closed = robots.add(tx, f"02:00:00:00:00:0{number}", f"closed-{number}")
            robots.set_state(tx, closed, state)
            robots.set_shell(tx, closed, on=on)
        users.set_disabled(tx, users.add(tx, "gone", "x", "admin"), disabled=True)
        for name in ("ann", "ben", "root", "gone"):
            users.add_ssh_key(
                tx, users.get(tx, name), "k", PublicKey("ssh-ed25519 A", f"SHA256:{name}")
            )
        for name in "abc":
            key = PublicKey(f"ssh-ed25519 {name}", f"SHA256:{name}")
            robots.set_key(tx, ids[name], key, Report("turtle", "0.1.0", "192.0.2.1"))
            robots.set_state(tx, ids[name], "active")
            robots.set_shell(tx, ids[name], on=True)
    ends = (None, now() + HOUR, now() - HOUR)
    holders = ({"user_id": ids["ben"]}, {"group_id": ids["crew"]})
    scopes = ({"robot_id": ids["c"]}, {"site_id": ids["lab"]}, {"all_robots": True})
    for holder, scope, level, end in itertools.product(holders, scopes, ("drive", "manage"), ends):
        with database.transaction() as tx:
            tx.change("DELETE FROM grants")
            grants.put(tx, Pair(**holder, **scope), level, end)
            grants.put(tx, Pair(group_id=ids["crew"], robot_id=ids["a"]), "manage")
        expected = {
            (user, robot)
            for (user, robot), level in held(database).items()
            if level == "manage" and not robot.startswith("closed")
        }
        with Database(mariadb.settings("keylookup")).transaction() as tx:
            rows = tx.rows("SELECT * FROM jump_keys")
        assert {(row["user_name"], row["robot"]) for row in rows} == expected
        assert len(rows) == len(expected)
        assert all(row["fingerprint"] == f"SHA256:{row['user_name']}" for row in rows)
        assert all(row["public_key"] == "ssh-ed25519 A" and row["shell_port"] for row in rows)

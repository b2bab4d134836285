"""What the relay reads and writes, in the real database, with the relay's own account."""

import datetime as dt
import json

import pytest
from granted import give
from relay_server import cell_settings
from robotether_server.db import cells, credentials, fleet, robots, users
from robotether_server.db.fleet import (
    FormerSessions,
    RelayUser,
    SessionEntry,
)
from robotether_server.problems import RecordRefusedError
from robotether_server.relay.auth.credentials import credential_of
from robotether_server.settings.robot import DEFAULTS

HOUR = dt.timedelta(hours=1)
MAC = "00:1b:44:11:3a:b{}"
NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)


@pytest.fixture
def sim1(database):
    """The id of robot sim1, active, which ann drives and admin root manages."""
    with database.transaction() as tx:
        robot_id = robots.add(tx, MAC.format(1), "sim1")
        robots.set_state(tx, robot_id, "active")
        ann = users.add(tx, "ann", "x", "user")
        users.add(tx, "root", "x", "admin")
        give(tx, ann, robot_id, "drive")
    return robot_id


def test_the_snapshot_is_of_one_moment(database, relay_database, sim1, monkeypatch):
    """A grant that is given between its questions is not in it, nor anything else that its version does not tell of."""
    really_changes, olga = fleet.changes, 0

    def changes_then_grant(tx):
        nonlocal olga
        found = really_changes(tx)
        with database.transaction() as web:
            olga = users.add(web, "olga", "x", "user")
            give(web, olga, sim1, "observe")
            robots.add(web, MAC.format(9), "sim9")
        return found

    with database.transaction() as tx:
        ann, root = (users.get(tx, name).id for name in ("ann", "root"))
    with relay_database.transaction() as tx:
        before = fleet.changes(tx).rights
    monkeypatch.setattr(fleet, "changes", changes_then_grant)
    with relay_database.transaction() as tx:
        snapshot = fleet.load(tx)
    assert snapshot.rights == before
    levels = [snapshot.level(user, sim1) for user in (ann, root, olga, 999)]
    assert levels == ["drive", "manage", None, None]
    assert [snapshot.visible(user) for user in (ann, olga)] == [[snapshot.robots[sim1]], []]
    assert set(snapshot.by_name) == {"sim1"}


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE robots SET name = 'turtle'",
        "UPDATE robots SET state = 'disabled'",
        "UPDATE robots SET shell = TRUE",
        "UPDATE robots SET public_key = 'k', fingerprint = 'SHA256:b'",
        "UPDATE robots SET rotate_requested_at = CURRENT_TIMESTAMP(6)",
        "UPDATE robots SET ros_port = 30000, video_port = 30001",
        "DELETE FROM robots",
        "INSERT INTO robots (mac, name) VALUES ('00:1b:44:11:3a:c0', 'sim9')",
        "UPDATE grants SET level = 'observe'",
        "DELETE FROM grants",
        "UPDATE users SET disabled = TRUE WHERE name = 'ann'",
        "UPDATE users SET role = 'admin' WHERE name = 'ann'",
    ],
)
def test_every_change_of_rights_shows(database, relay_database, sim1, change):
    with relay_database.transaction() as tx:
        before = fleet.changes(tx)
    with database.transaction() as tx:
        assert tx.change(change) > 0
    with relay_database.transaction() as tx:
        after = fleet.changes(tx)
        assert after.rights != before.rights
    with relay_database.transaction() as tx:
        assert fleet.load(tx).rights == after.rights


@pytest.mark.parametrize(
    ("change", "shows"),
    [
        ("UPDATE robots SET name = name", False),
        ("DELETE FROM logins", True),
        ("DELETE FROM api_tokens", True),
        (
            "INSERT INTO logins (token_hash, user_id, address, expires_at) "
            "SELECT REPEAT('x', 32), id, '', NOW() + INTERVAL 1 HOUR FROM users WHERE name = 'ann'",
            True,
        ),
    ],
)
def test_credentials_change_without_the_rights(database, relay_database, sim1, change, shows):
    """Logging in and out makes the relay ask for credentials, and not reload the fleet."""
    with database.transaction() as tx:
        ann = users.get(tx, "ann")
        credentials.create_login(tx, ann, "192.0.2.1", HOUR)
        credentials.create_token(tx, ann, "t", None)
    with relay_database.transaction() as tx:
        before = fleet.changes(tx)
    with database.transaction() as tx:
        tx.change(change)
    with relay_database.transaction() as tx:
        after = fleet.changes(tx)
    assert after.rights == before.rights
    assert (after.credentials != before.credentials) is shows


def test_credentials_tell_their_users(database, relay_database, sim1):
    with database.transaction() as tx:
        ann, root = users.get(tx, "ann"), users.get(tx, "root")
        login = credential_of("login", credentials.create_login(tx, ann, "", HOUR))
        token = credential_of("token", credentials.create_token(tx, root, "bench", None))
        over = credential_of("token", credentials.create_token(tx, ann, "old", NOON - 100 * HOUR))
    unknown = credential_of("login", "rubbish")
    swapped = fleet.Credential("token", login.digest)
    with relay_database.transaction() as tx:
        found = fleet.users_of(tx, [login, token, over, unknown, swapped])
    assert found == {login: RelayUser(ann.id, "ann"), token: RelayUser(root.id, "root")}


def test_a_session_is_written_twice_into_one_row(database, relay_database, sim1):
    entry = SessionEntry(sim1, NOON, "198.51.100.7", agent_version="0.1.0" * 20)
    with relay_database.transaction() as tx:
        (entry.row_id,) = fleet.write(tx, [entry], "a").values()
    entry.ended_at, entry.end_code, entry.ros_exposed = NOON + HOUR, "timeout", True
    entry.epoch = 2**53
    with relay_database.transaction() as tx:
        assert fleet.write(tx, [entry], "a") == {}
        (row,) = tx.rows("SELECT * FROM robot_sessions")
        assert fleet.last_seen(tx) == [(sim1, NOON + HOUR, "timeout")]
    assert (row["started_at"], row["ended_at"]) == (NOON, NOON + HOUR)
    assert (row["address"], row["end_code"]) == ("198.51.100.7", "timeout")
    assert len(row["agent_version"]) == fleet.MAX_VERSION
    assert (row["cell"], row["epoch"], row["ros_exposed"]) == ("a", 2**53, True)


def test_another_version_of_the_agent_is_in_the_audit_log(database, relay_database, sim1):
    """A session begins before the robot has said its version, and is written several times."""
    for version in ("0.1.0", "0.1.0", "0.2.0"):
        entry = SessionEntry(sim1, NOON, "198.51.100.7")
        with relay_database.transaction() as tx:
            (entry.row_id,) = fleet.write(tx, [entry], "a").values()
        entry.agent_version = version
        for _ in range(2):
            with relay_database.transaction() as tx:
                fleet.write(tx, [entry], "a")
    with database.transaction() as tx:
        rows = tx.rows("SELECT details FROM audit_events WHERE kind = 'robot_version' ORDER BY id")
    assert [json.loads(row["details"]) for row in rows] == [
        {"was": None, "agent_version": "0.1.0"},
        {"was": "0.1.0", "agent_version": "0.2.0"},
    ]


def test_a_robot_of_a_dead_cell_was_last_seen_when_that_died(relay_database, admin_database, sim1):
    """Nobody could write that its session ended."""
    with relay_database.transaction() as tx:
        cells.write_heartbeat(tx, cell_settings("a"), cells.CellCounts(), NOON)
        fleet.write(tx, [SessionEntry(sim1, NOON, "")], "a")
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = %s", (NOON + HOUR,))
    with relay_database.transaction() as tx:
        assert fleet.last_seen(tx) == [(sim1, NOON + HOUR, "cell_removed")]


def test_sessions_of_other_cells_are_left_open(relay_database, sim1):
    """So are those since the start; but those of a relay from before there were cells are nobody else's."""
    with relay_database.transaction() as tx:
        for cell in ("a", "b", None):
            fleet.write(tx, [SessionEntry(sim1, NOON, "")], cell)
        fleet.write(tx, [SessionEntry(sim1, NOON + 2 * HOUR, "")], "a")
        fleet.write(tx, [FormerSessions(before=NOON + HOUR)], "a")
        rows = tx.rows("SELECT cell, end_code FROM robot_sessions ORDER BY id")
    assert [(row["cell"], row["end_code"]) for row in rows] == [
        ("a", "relay_restarted"),
        ("b", None),
        (None, "relay_restarted"),
        ("a", None),
    ]


def test_a_session_of_a_robot_that_is_gone_is_refused(relay_database, sim1):
    with pytest.raises(RecordRefusedError), relay_database.transaction() as tx:
        fleet.write(tx, [SessionEntry(999_999, NOON, "")])


def test_settings_that_cannot_be_read_let_nobody_move_the_robot(
    database, relay_database, sim1, caplog
):
    """Somebody wrote a member that there is not; the other robots are read as ever."""
    with database.transaction() as tx:
        site = tx.insert("INSERT INTO sites (name) VALUES ('lab')")
        facts = (site, '{"guard": {"deadman_ms": 300}}')
        tx.change("UPDATE robots SET site_id = %s, settings = %s", facts)
    with relay_database.transaction() as tx:
        robot = fleet.load(tx).robots[sim1]
    assert (robot.mac, robot.site) == (MAC.format(1), "lab")
    assert robot.settings.guard.deadman_ms == 300
    assert robot.settings.policy == DEFAULTS.policy
    with database.transaction() as tx:
        tx.change("""UPDATE robots SET settings = '{"guard": {"max_sped": 1}}'""")
    with relay_database.transaction() as tx:
        settings = fleet.load(tx).robots[sim1].settings
    assert not settings.policy.drive.drives
    assert not settings.policy.manage.publish.match("/cmd_vel")
    assert "robot sim1: its settings are locked" in caplog.text

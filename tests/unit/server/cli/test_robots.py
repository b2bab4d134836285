"""robotether robot."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

import pytest
from robotether_server.cli import robots as robots_command
from robotether_server.ssh_keys import PublicKey
from robotether_server.store import Database, grants, robots, users
from robotether_server.store.robots import Report, State

Run = Callable[..., Any]
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:abc")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:other")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")
ADD = ("robot", "add", "sim1", "--mac", "0200.0000.5101")


def show_key(database: Database, key: PublicKey = KEY) -> None:
    with database.transaction() as tx:
        robots.set_key(tx, robots.get(tx, "sim1").id, key, REPORT)


def events(database: Database) -> list[tuple[str, str, str]]:
    with database.transaction() as tx:
        rows = tx.rows("SELECT actor, kind, robot FROM audit_events ORDER BY id")
    return [(row["actor"], row["kind"], row["robot"]) for row in rows]


def state(database: Database) -> State:
    with database.transaction() as tx:
        return robots.get(tx, "sim1").state


def details_of(database: Database, kind: str) -> list[dict[str, object]]:
    with database.transaction() as tx:
        rows = tx.rows("SELECT details FROM audit_events WHERE kind = %s ORDER BY id", (kind,))
    return [json.loads(row["details"]) for row in rows]


def test_added_robot_is_listed(run: Run, database: Database) -> None:
    """For people and for programs, with its ports and its MAC in one spelling."""
    assert run(*ADD).out == "added robot sim1 with ports 20000 and 20001\n"
    heads, row = run("robot", "list").out.splitlines()
    assert heads.split() == ["NAME", "STATE", "ONLINE", "SINCE", "MAC", "ROS", "VIDEO", "KEY"]
    assert row.split()[:5] == ["sim1", "pending", "no", "never", "02:00:00:00:51:01"]
    assert json.loads(run("robot", "list", "--json").out) == [
        {
            "name": "sim1",
            "mac": "02:00:00:00:51:01",
            "state": "pending",
            "online": False,
            "since": None,
            "ros_port": 20000,
            "video_port": 20001,
            "fingerprint": None,
            "joined_at": None,
        }
    ]
    assert events(database) == [("cli", "robot_added", "sim1")]


@pytest.mark.parametrize(
    ("name", "mac", "says"),
    [
        ("sim1", "02:00:00:00:51:02", "another robot has the name sim1"),
        ("sim2", "02:00:00:00:51:01", "another robot has the MAC 02:00:00:00:51:01"),
        ("sim2", "rubbish", "is no MAC address"),
        ("Sim 2", "02:00:00:00:51:02", "a name has a-z, 0-9 and -"),
    ],
)
def test_robot_that_cannot_be_is_refused(run: Run, name: str, mac: str, says: str) -> None:
    """In one sentence, exit status 1."""
    run(*ADD)
    done = run("robot", "add", name, "--mac", mac)
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert says in done.err


def test_robot_without_a_key_cannot_be_approved(run: Run) -> None:
    """There is nothing yet to approve."""
    run(*ADD)
    done = run("robot", "approve", "sim1")
    assert done.status == 1
    assert "has not joined yet" in done.err


def test_robot_is_approved_disabled_and_enabled(run: Run, database: Database) -> None:
    """A second approval changes nothing; each change has one audit event."""
    run(*ADD)
    show_key(database)
    for _ in range(2):
        done = run("robot", "approve", "sim1", "--yes")
        assert done.out == "robot sim1 is active with key SHA256:abc\n"
    assert run("robot", "disable", "sim1").status == 0
    refused = run("robot", "approve", "sim1")
    assert "robotether robot enable sim1" in refused.err
    assert run("robot", "enable", "sim1").out == "robot sim1 is active\n"
    assert "it is active, not disabled" in run("robot", "enable", "sim1").err
    assert [kind for _, kind, _ in events(database)] == [
        "robot_added",
        "robot_approved",
        "robot_disabled",
        "robot_enabled",
    ]


def test_approve_shows_who_joined_and_asks(run: Run, database: Database) -> None:
    """All that tells one robot from another stands there before the question; only a yes approves."""
    run(*ADD)
    show_key(database)
    for answer in ("", "\n", "n\n"):
        done = run("robot", "approve", "sim1", terminal=answer)
        assert done.status == 1
        assert state(database) == "pending"
    shown = dict(line.split("  ", 1) for line in done.out.splitlines() if "  " in line)
    assert {name: value.strip() for name, value in shown.items() if name != "joined"} == {
        "robot": "sim1 (pending)",
        "MAC": "02:00:00:00:51:01",
        "host name": "turtle",
        "address": "192.0.2.1",
        "key": "SHA256:abc",
    }
    assert shown["joined"].endswith(" UTC")
    assert "did not approve robot sim1" in done.err
    done = run("robot", "approve", "sim1", terminal="y\n")
    assert (done.status, state(database)) == (0, "active")
    [details] = details_of(database, "robot_approved")
    assert details == {"was": "pending", "fingerprint": "SHA256:abc"}


def test_approve_without_a_terminal_needs_the_fingerprint(run: Run, database: Database) -> None:
    """One sentence says what to do; a script that only says yes on standard input gets nothing."""
    run(*ADD)
    show_key(database)
    done = run("robot", "approve", "sim1", stdin="y\n")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "no terminal to ask on" in done.err
    assert "--fingerprint" in done.err
    assert state(database) == "pending"


def test_approve_with_a_fingerprint(run: Run, database: Database) -> None:
    """Only the key that the robot itself shows is approved, and --yes does not change that."""
    run(*ADD)
    show_key(database)
    for more in ((), ("--yes",)):
        done = run("robot", "approve", "sim1", "--fingerprint", "SHA256:other", *more)
        assert (done.status, done.err.count("\n")) == (1, 1)
        assert "its key is SHA256:abc, not SHA256:other" in done.err
        assert "robotether robot rekey sim1" in done.err
        assert state(database) == "pending"
    assert run("robot", "approve", "sim1", "--fingerprint", "SHA256:abc").status == 0
    assert state(database) == "active"


def test_approve_takes_only_the_key_that_was_compared(
    run: Run, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A key that came while the person was looking is not approved in its place."""
    run(*ADD)
    show_key(database)
    monkeypatch.setattr(robots_command, "agree", lambda *_: show_key(database, OTHER_KEY))
    done = run("robot", "approve", "sim1")
    assert "its key is SHA256:other, not SHA256:abc" in done.err
    assert state(database) == "pending"


def test_enable_approves_no_key_in_passing(run: Run, database: Database) -> None:
    """The key of a robot that nobody has approved is forgotten when it is disabled."""
    run(*ADD)
    show_key(database)
    run("robot", "disable", "sim1")
    assert run("robot", "enable", "sim1").out == "robot sim1 is pending\n"
    assert "has not joined yet" in run("robot", "approve", "sim1", "--yes").err


@pytest.mark.parametrize(
    ("before", "after"), [("active", "pending"), ("pending", "pending"), ("disabled", "disabled")]
)
def test_rekey_forgets_the_key(run: Run, database: Database, before: State, after: State) -> None:
    """The old key opens nothing from now on; a disabled robot stays so."""
    run(*ADD)
    show_key(database)
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "sim1").id, before)
    done = run("robot", "rekey", "sim1")
    assert done.out == "robot sim1 has no key any more; it had SHA256:abc\n"
    with database.transaction() as tx:
        found = robots.get(tx, "sim1")
    assert (found.state, found.fingerprint) == (after, None)
    assert details_of(database, "robot_rekeyed") == [{"was": before, "fingerprint": "SHA256:abc"}]


def test_removed_robot_is_gone_with_its_grants(run: Run, database: Database) -> None:
    """After a yes, or with --yes; the audit log keeps what it was."""
    run(*ADD)
    show_key(database)
    with database.transaction() as tx:
        ann = users.add(tx, "ann", "x", "user")
        grants.give(tx, ann, robots.get(tx, "sim1").id, "drive")
    assert "no terminal to ask on; say --yes" in run("robot", "remove", "sim1").err
    refused = run("robot", "remove", "sim1", terminal="n\n")
    assert "02:00:00:00:51:01" in refused.out
    assert "did not remove robot sim1" in refused.err
    assert run("robot", "remove", "sim1", terminal="y\n").status == 0
    run(*ADD)
    assert run("robot", "remove", "sim1", "--yes").out == "removed robot sim1\n"
    with database.transaction() as tx:
        assert robots.list_all(tx) == []
        assert tx.rows("SELECT * FROM grants") == []
    assert details_of(database, "robot_removed")[0] == {
        "was": "pending",
        "mac": "02:00:00:00:51:01",
        "fingerprint": "SHA256:abc",
    }


def test_robot_without_a_key_is_enabled_to_wait(run: Run) -> None:
    """An active row without a key would mean nothing."""
    run(*ADD)
    run("robot", "disable", "sim1")
    assert run("robot", "enable", "sim1").out == "robot sim1 is pending\n"


def test_approve_waits_for_the_key(run: Run, database: Database) -> None:
    """The robot may join while the command waits."""
    run(*ADD)
    joins = threading.Timer(0.2, show_key, [database])
    joins.start()
    assert run("robot", "approve", "sim1", "--yes", "--wait-for-key", "20").status == 0
    joins.join()


def test_wait_online(run: Run, admin_database: Database) -> None:
    """Ends well once a session is open, and says so when none comes."""
    run(*ADD)
    done = run("robot", "wait-online", "sim1", "--timeout", "0")
    assert done.status == 1
    assert "cannot see robot sim1 online after 0 s" in done.err
    with admin_database.transaction() as tx:
        tx.change("INSERT INTO robot_sessions (robot_id, address) SELECT id, '' FROM robots")
    assert run("robot", "wait-online", "sim1").out == "robot sim1 is online\n"
    assert run("robot", "list").out.splitlines()[1].split()[2] == "yes"


@pytest.mark.parametrize(
    "command", ["approve", "disable", "enable", "rekey", "remove", "wait-online"]
)
def test_unknown_robot_is_said(run: Run, command: str) -> None:
    """In one sentence."""
    done = run("robot", command, "ghost")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "cannot find robot ghost" in done.err

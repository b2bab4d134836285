"""robotether robot."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

import pytest
from robotether_server.ssh_keys import PublicKey
from robotether_server.store import Database, robots

Run = Callable[..., Any]
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:abc")
ADD = ("robot", "add", "sim1", "--mac", "0200.0000.5101")


def show_key(database: Database) -> None:
    with database.transaction() as tx:
        robots.set_key(tx, robots.get(tx, "sim1").id, KEY)


def events(database: Database) -> list[tuple[str, str, str]]:
    with database.transaction() as tx:
        rows = tx.rows("SELECT actor, kind, robot FROM audit_events ORDER BY id")
    return [(row["actor"], row["kind"], row["robot"]) for row in rows]


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
        assert run("robot", "approve", "sim1").out == "robot sim1 is active with key SHA256:abc\n"
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
    assert run("robot", "approve", "sim1", "--wait-for-key", "20").status == 0
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


@pytest.mark.parametrize("command", ["approve", "disable", "enable", "wait-online"])
def test_unknown_robot_is_said(run: Run, command: str) -> None:
    """In one sentence."""
    done = run("robot", command, "ghost")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "cannot find robot ghost" in done.err

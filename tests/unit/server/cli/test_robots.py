"""robotether robot add, list, show, remove, wait-online."""

from __future__ import annotations

import json

import pytest
from admin_records import ADD, MAC, Run, activate, claim, details_of, events, kinds, robot, show_key
from granted import give
from robotether_server.db import Database, robots, seen_robots, users


def test_added_robot_is_listed(run: Run, database: Database) -> None:
    """For people and for programs, with its ports and its MAC in one spelling."""
    assert run(*ADD).out == "added robot sim1 with ports 20000 and 20001\n"
    heads, row = run("robot", "list").out.splitlines()
    assert " ".join(heads.split()) == "NAME STATE ONLINE SINCE MAC ROS VIDEO SHELL KEY"
    assert row.split()[:5] == ["sim1", "pending", "no", "never", MAC]
    assert json.loads(run("robot", "list", "--json").out) == [
        {
            "name": "sim1",
            "mac": MAC,
            "state": "pending",
            "online": False,
            "since": None,
            "ros_port": 20000,
            "video_port": 20001,
            "shell_port": None,
            "settings": {},
            "site": None,
            "fingerprint": None,
            "joined_at": None,
            "address": None,
            "agent_version": None,
            "rotate_key": False,
        }
    ]
    assert events(database) == [("cli", "robot_added", "sim1")]


def test_show_tells_all_of_one_robot(
    run: Run, database: Database, admin_database: Database
) -> None:
    """Its record, what waits there, and its last sessions."""
    run(*ADD)
    assert "never seen" in run("robot", "show", "sim1").out
    activate(database)
    claim(database)
    with admin_database.transaction() as tx:
        tx.change(
            "INSERT INTO robot_sessions (robot_id, address, agent_version) "
            "SELECT id, '198.51.100.7', '0.2.0' FROM robots"
        )
    shown = run("robot", "show", "sim1").out
    for text in (
        "sim1 (active)",
        "SHA256:abc",
        "SHA256:other",
        "MAC is in use",
        "198.51.100.7",
        "ongoing",
    ):
        assert text in shown
    whole = json.loads(run("robot", "show", "sim1", "--json").out)
    assert (whole["address"], whole["agent_version"]) == ("198.51.100.7", "0.2.0")
    assert [one["reason"] for one in whole["waiting"]] == ["mac_in_use"]
    assert [one["ended_at"] for one in whole["sessions"]] == [None]


def test_removed_robot_is_gone_with_its_grants(run: Run, database: Database) -> None:
    """After a yes, or with --yes; the audit log keeps what it was."""
    run(*ADD)
    show_key(database)
    with database.transaction() as tx:
        ann = users.add(tx, "ann", "x", "user")
        give(tx, ann, robots.get(tx, "sim1").id, "drive")
    assert "no terminal to ask on; say --yes" in run("robot", "remove", "sim1").err
    refused = run("robot", "remove", "sim1", terminal="n\n")
    assert MAC in refused.out
    assert "did not remove robot sim1" in refused.err
    assert run("robot", "remove", "sim1", terminal="y\n").status == 0
    run(*ADD)
    assert run("robot", "remove", "sim1", "--yes").out == "removed robot sim1\n"
    with database.transaction() as tx:
        assert seen_robots.list_all(tx) == []
        assert tx.rows("SELECT * FROM grants") == []
    assert details_of(database, "robot_removed")[0] == {
        "was": "pending",
        "mac": MAC,
        "fingerprint": "SHA256:abc",
    }


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


def test_unknown_robot_is_said(run: Run) -> None:
    """In one sentence, by each command."""
    plain = (
        "approve disable enable move-ports reject rekey remove rotate-key settings show wait-online"
    )
    for name, *more in (
        *([one] for one in plain.split()),
        ["rename", "x"],
        ["set", "--shell-user", "pi"],
        ["set-mac", "00:1b:44:11:3a:b7"],
        ["shell", "on"],
    ):
        done = run("robot", name, "ghost", *more)
        assert (done.status, done.err.count("\n")) == (1, 1), name
        assert "cannot find robot ghost" in done.err


@pytest.fixture
def _sim1(run: Run) -> None:
    run(*ADD)


@pytest.mark.usefixtures("_sim1")
def test_robot_is_disabled_and_enabled(run: Run, database: Database) -> None:
    """Each change has one audit event."""
    activate(database)
    assert run("robot", "disable", "sim1").out == "robot sim1 is disabled\n"
    assert run("robot", "enable", "sim1").out == "robot sim1 is active\n"
    assert "it is active, not disabled" in run("robot", "enable", "sim1").err
    assert kinds(database)[1:] == ["robot_disabled", "robot_enabled"]


@pytest.mark.usefixtures("_sim1")
def test_robot_gets_another_name(run: Run, database: Database) -> None:
    """Which must be free, and a name."""
    assert run("robot", "rename", "sim1", "turtle").out == "robot sim1 is now turtle\n"
    run("robot", "add", "sim2", "--mac", "00:1b:44:11:3a:b7")
    assert "another robot has it" in run("robot", "rename", "sim2", "turtle").err
    assert run("robot", "rename", "sim2", "No Name").status == 1
    assert kinds(database).count("robot_renamed") == 1


@pytest.mark.usefixtures("_sim1")
def test_robot_gets_another_mac(run: Run, database: Database) -> None:
    """In one spelling; one that a machine has given itself only when that is said."""
    done = run("robot", "set-mac", "sim1", "001B.4411.3AB7")
    assert done.out == "robot sim1 has MAC 00:1b:44:11:3a:b7\n"
    assert "locally administered" in run("robot", "set-mac", "sim1", "02:00:00:00:00:07").err
    arguments = ("set-mac", "sim1", "02:00:00:00:00:07", "--allow-local-mac")
    assert run("robot", *arguments).status == 0
    assert robot(database).mac == "02:00:00:00:00:07"


@pytest.mark.usefixtures("_sim1")
def test_robot_moves_to_other_ports(run: Run, database: Database) -> None:
    """To those that are given, or to any that are free."""
    arguments = ("--ros", "20100", "--video", "20101")
    done = run("robot", "move-ports", "sim1", *arguments)
    assert done.out == "robot sim1 has ports 20100 and 20101\n"
    assert "go together" in run("robot", "move-ports", "sim1", "--ros", "20102").err
    run("robot", "move-ports", "sim1")
    assert robot(database).ros_port != 20100


@pytest.mark.usefixtures("_sim1")
def test_shell_has_a_port_while_it_is_on(run: Run, database: Database) -> None:
    """A shell has a port only while it is on."""
    port = 24000
    done = run("robot", "shell", "sim1", "on")
    assert done.out == f"the shell of robot sim1 is on, at port {port} of the server\n"
    assert robot(database).shell_port == port
    assert run("robot", "shell", "sim1", "off").out == "the shell of robot sim1 is off\n"
    assert robot(database).shell_port is None

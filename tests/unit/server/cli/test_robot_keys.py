"""robotether robot pending, approve, reject, rekey, rotate-key."""

import json
import threading

import pytest
from admin_records import ADD, MAC, OTHER_KEY, activate, claim, kinds, robot, show_key
from robotether_server.cli import robot_keys
from robotether_server.db import robots
from robotether_server.identity import PublicKey

THIRD_KEY = PublicKey("ssh-ed25519 CCCC", "SHA256:third")


def shown(out):
    lines = (line.split("  ", 1) for line in out.splitlines() if "  " in line)
    return {name: value.strip() for name, value in lines}


def test_what_waits_is_listed(run, database):
    run(*ADD)
    assert len(run("robot", "pending").out.splitlines()) == 1
    activate(database)
    claim(database)
    run("robot", "add", "sim2", "--mac", "00:1b:44:11:3a:b7")
    with database.transaction() as tx:
        robots.set_key(tx, robots.get(tx, "sim2").id, THIRD_KEY, robots.Report("two", "1", "::1"))
    _, *rows = run("robot", "pending").out.splitlines()
    assert sorted(row.split()[0] for row in rows) == ["sim1", "sim2"]
    found = {item["robot"]: item for item in json.loads(run("robot", "pending", "--json").out)}
    assert {name: item["reason"] for name, item in found.items()} == {
        "sim1": "mac_in_use",
        "sim2": "approval_pending",
    }
    assert found["sim1"]["fingerprint"] == "SHA256:other"
    assert "MAC is in use" in "".join(rows)


def test_approve_shows_who_joined_and_asks(run, database):
    """All that tells one robot from another stands there before the question; only a yes approves."""
    run(*ADD)
    show_key(database)
    for answer in ("", "\n", "n\n"):
        done = run("robot", "approve", "sim1", terminal=answer)
        assert done.status == 1
        assert robot(database).state == "pending"
    fields = shown(done.out)
    assert fields.pop("joined").endswith(" UTC")
    assert fields == {
        "robot": "sim1 (pending)",
        "MAC": MAC,
        "host name": "turtle",
        "address": "192.0.2.1",
        "key": "SHA256:abc",
    }
    assert "did not approve robot sim1" in done.err
    done = run("robot", "approve", "sim1", terminal="y\n")
    assert (done.status, robot(database).state) == (0, "active")


def test_approve_without_a_terminal_needs_the_fingerprint(run, database):
    """It must be that of the key that the robot itself shows; --yes does not change that."""
    run(*ADD)
    show_key(database)
    for options, said in (
        ((), "no terminal to ask on; take the key SHA256:abc"),
        (("--fingerprint", "SHA256:other"), "its key is SHA256:abc, not SHA256:other"),
        (("--fingerprint", "SHA256:other", "--yes"), "robotether robot rekey sim1"),
    ):
        done = run("robot", "approve", "sim1", *options, stdin="y\n")
        assert (done.status, done.err.count("\n"), said in done.err) == (1, 1, True)
    run("robot", "disable", "sim1")
    assert "robotether robot enable sim1" in run("robot", "approve", "sim1").err
    run("robot", "enable", "sim1")
    show_key(database)
    assert run("robot", "approve", "sim1", "--fingerprint", "SHA256:abc").status == 0
    assert robot(database).state == "active"


@pytest.mark.parametrize("action", ["approve", "reject"])
def test_only_the_key_that_was_compared_counts(run, database, monkeypatch, action):
    """A key that came while the person was looking is not dealt with in its place."""
    run(*ADD)
    show_key(database)
    monkeypatch.setattr(robot_keys, "agree", lambda *_: show_key(database, OTHER_KEY))
    done = run("robot", action, "sim1")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "SHA256:abc" in done.err
    found = robot(database)
    assert (found.state, found.fingerprint) == ("pending", "SHA256:other")


def test_approve_waits_for_the_key(run, database):
    run(*ADD)
    joins = threading.Timer(0.2, show_key, [database])
    joins.start()
    assert run("robot", "approve", "sim1", "--yes", "--wait-for-key", "20").status == 0
    joins.join()


def test_approved_claim_replaces_the_key(run, database):
    run(*ADD)
    activate(database)
    claim(database)
    refused = run("robot", "approve", "sim1", terminal="n\n")
    fields = shown(refused.out)
    assert (fields["key"], fields["host name"]) == ("SHA256:other", "copy")
    assert "another key, SHA256:abc, and keeps it" in fields["beware"]
    assert robot(database).fingerprint == "SHA256:abc"
    done = run("robot", "approve", "sim1", terminal="y\n")
    assert done.out.endswith("robot sim1 is active with key SHA256:other\n")
    assert robot(database).fingerprint == "SHA256:other"
    again = run("robot", "approve", "sim1")
    assert again == (0, "robot sim1 is active with key SHA256:other\n", "")


def test_of_several_keys_one_is_named(run, database):
    """Neither --yes nor a person's yes chooses among them."""
    run(*ADD)
    show_key(database)
    claim(database)
    for more in (("--yes",), ()):
        done = run("robot", "approve", "sim1", *more, terminal="y\n")
        assert done.status == 1
        assert "SHA256:abc from 192.0.2.1, SHA256:other from 192.0.2.2" in done.err
    assert "say --fingerprint" in run("robot", "reject", "sim1").err
    assert run("robot", "approve", "sim1", "--fingerprint", "SHA256:other").status == 0
    assert robot(database).fingerprint == "SHA256:other"


def test_rejected_key_may_ask_again(run, database):
    run(*ADD)
    show_key(database)
    run("robot", "reject", "sim1", "--fingerprint", "SHA256:abc")
    [item] = json.loads(run("rejected", "list", "--json").out)
    assert (item["robot"], item["rejected_by"]) == ("sim1", "cli")
    row = run("rejected", "list").out.splitlines()[1].split()
    assert (row[0], row[-1]) == (str(item["id"]), "SHA256:abc")
    assert "so there is no key to reject" in run("robot", "reject", "sim1").err
    assert run("rejected", "forgive", item["id"]).out == "key SHA256:abc may ask again\n"
    assert json.loads(run("rejected", "list", "--json").out) == []
    assert run("rejected", "forgive", item["id"]).status == 1
    assert kinds(database)[-1] == "key_forgiven"

"""robotether robot pending, approve, reject, rekey, rotate-key."""

import json

import pytest
from admin_records import ADD, OTHER_KEY, activate, claim, kinds, robot, show_key
from robotether_server.cli import robot_keys


def shown(out):
    lines = (line.split("  ", 1) for line in out.splitlines() if "  " in line)
    return {name: value.strip() for name, value in lines}


def test_what_waits_is_listed(run, database):
    """A claim's question says which key the robot has, and that it may be the right one."""
    run(*ADD)
    assert len(run("robot", "pending").out.splitlines()) == 1
    activate(database)
    claim(database)
    _, row = run("robot", "pending").out.splitlines()
    assert row.startswith("sim1 ")
    assert "MAC is in use" in row
    [item] = json.loads(run("robot", "pending", "--json").out)
    assert (item["reason"], item["fingerprint"]) == ("mac_in_use", "SHA256:other")
    fields = shown(run("robot", "approve", "sim1", terminal="n\n").out)
    assert (fields["key"], fields["host name"]) == ("SHA256:other", "copy")
    assert "another key, SHA256:abc, and keeps it" in fields["beware"]
    assert (fields["joined"][-4:], robot(database).fingerprint) == (" UTC", "SHA256:abc")
    done = run("robot", "approve", "sim1", terminal="y\n")
    assert done.out.endswith("robot sim1 is active with key SHA256:other\n")


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

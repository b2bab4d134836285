"""Each change of robots, users, groups, sites and grants, and what the command says of it."""

import json

import click
import pytest
from admin_records import ADD, activate
from robotether_server import passwords
from robotether_server.db import users

CHANGES = (
    ("robot disable sim1", "robot sim1 is disabled"),
    ("robot enable sim1", "robot sim1 is active"),
    ("robot rotate-key sim1", "robot sim1 makes a new key as soon as it is online"),
    ("robot set-mac sim1 001B.4411.3AB7", "robot sim1 has MAC 00:1b:44:11:3a:b7"),
    ("robot set-mac sim1 2:0:0:0:0:7 --allow-local-mac", "robot sim1 has MAC 02:00:00:00:00:07"),
    ("robot move-ports sim1 --ros 20100 --video 20101", "robot sim1 has ports 20100 and 20101"),
    ("robot move-ports sim1", "robot sim1 has ports 20000 and 20001"),
    ("robot shell sim1 on", "the shell of robot sim1 is on, at port 24000 of the server"),
    ("robot shell sim1 off", "the shell of robot sim1 is off"),
    ("robot rekey sim1", "robot sim1 has no key now; it had SHA256:abc"),
    ("robot rename sim1 turtle", "robot sim1 is now turtle"),
    ("user add ann --password-stdin", "added user ann"),
    ("user disable ann", "disabled user ann"),
    ("user enable ann", "enabled user ann"),
    ("user role ann admin", "user ann has role admin"),
    ("user pools ann night crane", "user ann is in pools crane, night"),
    ("user pools ann", "user ann is in no pool"),
    ("user password ann --password-stdin", "user ann has a new password"),
    ("user logout ann", "ended 0 logins of user ann"),
    ("group add crew", "added group crew"),
    ("group join crew ann", "user ann is a member of group crew"),
    ("site add lab", "added site lab"),
    ("site place turtle lab", "robot turtle is at site lab"),
    ("grant --group crew turtle drive", "group crew may drive robot turtle"),
    ("revoke --group crew turtle", "group crew no longer has a grant for robot turtle"),
    ("grant ann --site lab manage", "user ann may manage site lab"),
    ("revoke ann --site=lab", "user ann no longer has a grant for site lab"),
    ("grant --group crew --all observe", "group crew may observe all robots"),
    ("revoke --group crew --all", "group crew no longer has a grant for all robots"),
    ("user add list --password-stdin", "added user list"),
    # A user may be called like a command: three words are always USER ROBOT LEVEL.
    ("grant list turtle drive", "user list may drive robot turtle"),
)


EMPTIED = (
    ("group leave crew ann", "user ann is no longer a member of group crew"),
    ("site place turtle", "robot turtle is at no site"),
)


def test_each_change_is_said(run, database):
    run(*ADD)
    activate(database)
    for words, said in CHANGES:
        assert run(*words.split(), stdin=f"password of {words}").out == said + "\n", words
    with database.transaction() as tx:
        hashed = users.get(tx, "ann").password_hash
    assert passwords.matches("password of user password ann --password-stdin", hashed)
    assert "it must be 1 to 63 characters" in run("user", "pools", "ann", "Night").err
    assert "go together" in run("robot", "move-ports", "turtle", "--ros", "20102").err
    groups, sites = (json.loads(run(kind, "list", "--json").out) for kind in ("group", "site"))
    assert groups == [{"name": "crew", "members": ["ann"]}]
    assert sites == [{"name": "lab", "robots": ["turtle"]}]
    for words, said in EMPTIED:
        assert run(*words.split()).out == said + "\n", words
    # The second has an umlaut of ISO 8859-1, as Python reads it from a terminal.
    for wrong in ("short", "p\udce4ssword of ann"):
        refused = run("user", "add", "bob", "--password-stdin", stdin=wrong)
        assert (refused.status, refused.err.count("\n")) == (1, 1)


@pytest.mark.parametrize(
    ("kind", "add"),
    [("user", ()), ("group", ()), ("site", ()), ("robot", ("--mac", "00:1b:44:11:3a:b7"))],
)
def test_a_removal_asks_first(run, kind, add):
    assert run(kind, "add", "x", *add).status == 0
    assert "no terminal to ask on; say --yes" in run(kind, "remove", "x").err
    refused = run(kind, "remove", "x", terminal="n\n")
    assert (refused.status, f"did not remove {kind} x" in refused.err) == (1, True)
    assert run(kind, "remove", "x", terminal="y\n").out.endswith(f"removed {kind} x\n")
    run(kind, "add", "x", *add)
    assert run(kind, "remove", "x", "--yes").out == f"removed {kind} x\n"
    assert run(kind, "remove", "x", "--yes").status == 1


def test_a_removal_is_of_the_robot_that_was_shown(run, database, monkeypatch):
    """Another one may get its name before the answer."""
    run("robot", "add", "x", "--mac", "00:1b:44:11:3a:b7")

    def answer(_question):
        with database.transaction() as tx:
            tx.change("UPDATE robots SET name = 'y'")
            tx.change("INSERT INTO robots (mac, name) VALUES ('00:1b:44:11:3a:b8', 'x')")
        return True

    monkeypatch.setattr(click, "confirm", answer)
    assert "another one has the name now" in run("robot", "remove", "x", terminal="y\n").err
    assert len(json.loads(run("robot", "list", "--json").out)) == 2

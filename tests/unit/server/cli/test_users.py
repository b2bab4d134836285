"""robotether user."""

import json

from robotether_server import passwords
from robotether_server.db import audit, users


def test_user_with_a_password_from_stdin(run, database):
    done = run("user", "add", "ann", "--password-stdin", stdin="a long enough password\n")
    assert done == (0, "added user ann\n", "")
    with database.transaction() as tx:
        user, found = users.get(tx, "ann"), audit.find(tx)
    assert user.role == "user"
    assert passwords.matches("a long enough password", user.password_hash)
    assert [(item.actor, item.kind) for item in found] == [("cli", "user_added")]


def test_user_that_cannot_be_is_refused_in_one_sentence(run):
    done = run("user", "add", "ann", "--password-stdin", stdin="short")
    assert (done.status, done.out) == (1, "")
    assert done.err.startswith("robotether: cannot ")
    assert done.err.count("\n") == 1
    assert run("user", "list").out.split() == ["NAME", "ROLE", "STATE"]


def test_each_change_of_a_user_is_said(run, database):
    run("user", "add", "ann")
    for words, said in (
        ("disable ann", "disabled user ann"),
        ("enable ann", "enabled user ann"),
        ("role ann admin", "user ann has role admin"),
        ("pools ann night crane", "user ann is in pools crane, night"),
        ("pools ann", "user ann is in no pool"),
        ("password ann --password-stdin", "user ann has a new password"),
        ("logout ann", "ended 0 logins of user ann"),
    ):
        assert run("user", *words.split(), stdin="another long password").out == said + "\n"
    with database.transaction() as tx:
        assert passwords.matches("another long password", users.get(tx, "ann").password_hash)


def test_users_are_listed(run, database):
    run("user", "add", "ann")
    run("user", "disable", "ann")
    made = run("user", "add", "root", "--role", "admin").out.split()[-1]
    with database.transaction() as tx:
        assert passwords.matches(made, users.get(tx, "root").password_hash)
    assert [line.split() for line in run("user", "list").out.splitlines()] == [
        ["NAME", "ROLE", "STATE"],
        ["ann", "user", "disabled"],
        ["root", "admin", "enabled"],
    ]
    first = json.loads(run("user", "list", "--json").out)[0]
    assert first == {"name": "ann", "role": "user", "disabled": True}


def test_removed_user_is_gone(run, database):
    run("user", "add", "ann")
    assert "no terminal to ask on; say --yes" in run("user", "remove", "ann").err
    assert "did not remove user ann" in run("user", "remove", "ann", terminal="n\n").err
    assert run("user", "remove", "ann", terminal="y\n").out.endswith("removed user ann\n")
    with database.transaction() as tx:
        assert users.find(tx, "ann") is None

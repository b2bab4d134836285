"""robotether user."""

from __future__ import annotations

import datetime as dt
import json

import pytest
from admin_records import Run
from robotether_server import passwords
from robotether_server.db import Database, credentials, users


def kinds(database: Database) -> list[str]:
    with database.transaction() as tx:
        return [
            f"{row['actor']} {row['kind']}"
            for row in tx.rows("SELECT * FROM audit_events ORDER BY id")
        ]


def test_user_with_a_password_from_stdin(run: Run, database: Database) -> None:
    """The password works and is not printed."""
    done = run("user", "add", "ann", "--password-stdin", stdin="a long enough password\n")
    assert done == (0, "added user ann\n", "")
    with database.transaction() as tx:
        user = users.get(tx, "ann")
    assert user.role == "user"
    assert passwords.matches("a long enough password", user.password_hash)
    assert kinds(database) == ["cli user_added"]


def test_user_with_a_generated_password(run: Run, database: Database) -> None:
    """The password is the last word that is printed."""
    done = run("user", "add", "root", "--role", "admin")
    with database.transaction() as tx:
        user = users.get(tx, "root")
    assert user.is_admin
    assert passwords.matches(done.out.split()[-1], user.password_hash)


@pytest.mark.parametrize(
    ("name", "stdin"), [("ann", "short"), ("ann", ""), ("An n", "a long enough password")]
)
def test_user_that_cannot_be_is_refused_in_one_sentence(run: Run, name: str, stdin: str) -> None:
    """Exit status 1, nothing made, nothing printed but the sentence."""
    done = run("user", "add", name, "--password-stdin", stdin=stdin)
    assert (done.status, done.out) == (1, "")
    assert done.err.startswith("robotether: cannot ")
    assert done.err.count("\n") == 1
    assert run("user", "list").out.split() == ["NAME", "ROLE", "STATE"]


def test_user_is_told_what_a_name_may_be(run: Run) -> None:
    """As on the page, in place of the database's own words."""
    for name in ("Ann", "-ann", "a" * 64):
        done = run("user", "add", "--", name)
        assert (done.status, done.out) == (1, "")
        assert done.err.startswith("robotether: cannot use name: it must be 1 to 63 characters a-z")


def test_new_password_replaces_the_old(run: Run, database: Database) -> None:
    """A new password leaves an audit event."""
    run("user", "add", "ann")
    run("user", "password", "ann", "--password-stdin", stdin="another long password")
    with database.transaction() as tx:
        assert passwords.matches("another long password", users.get(tx, "ann").password_hash)
    assert kinds(database) == ["cli user_added", "cli password_set"]


def test_disabled_user_is_listed_as_such(run: Run) -> None:
    """A disabled user is listed as such and can be enabled again."""
    run("user", "add", "ann")
    assert run("user", "disable", "ann").out == "disabled user ann\n"
    assert run("user", "list").out.splitlines()[1].split() == ["ann", "user", "disabled"]
    assert run("user", "enable", "ann").status == 0
    assert run("user", "list").out.splitlines()[1].split() == ["ann", "user", "enabled"]


def test_role_changes(run: Run, database: Database) -> None:
    """The last enabled admin stays one, enabled and there."""
    run("user", "add", "ann", "--role", "admin")
    for command in (("role", "ann", "user"), ("disable", "ann"), ("remove", "ann", "--yes")):
        done = run("user", *command)
        assert (done.status, done.err.count("\n")) == (1, 1)
        assert "nobody else is an admin" in done.err
    run("user", "add", "bob")
    assert run("user", "role", "bob", "admin").out == "user bob has role admin\n"
    assert run("user", "role", "ann", "user").status == 0
    assert kinds(database)[-1] == "cli user_role_set"


def test_logins_end_everywhere(run: Run, database: Database) -> None:
    """Logins end on every device at once."""
    run("user", "add", "ann")
    with database.transaction() as tx:
        ann = users.get(tx, "ann")
        for _ in range(2):
            credentials.create_login(tx, ann, "192.0.2.1", dt.timedelta(hours=1))
    assert run("user", "logout", "ann").out == "ended 2 logins of user ann\n"
    with database.transaction() as tx:
        assert tx.rows("SELECT * FROM logins") == []


def test_removed_user_is_gone(run: Run, database: Database) -> None:
    """After a yes, or with --yes."""
    run("user", "add", "ann")
    assert "no terminal to ask on; say --yes" in run("user", "remove", "ann").err
    assert "did not remove user ann" in run("user", "remove", "ann", terminal="n\n").err
    assert run("user", "remove", "ann", terminal="y\n").out.endswith("removed user ann\n")
    with database.transaction() as tx:
        assert users.find(tx, "ann") is None


def test_users_are_listed_for_programs(run: Run) -> None:
    """The list has no password hashes."""
    run("user", "add", "ann")
    [one] = json.loads(run("user", "list", "--json").out)
    assert one == {"name": "ann", "role": "user", "disabled": False}

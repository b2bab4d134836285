"""robotether user, grant and revoke."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from robotether_server import passwords
from robotether_server.store import Database, robots, users

Run = Callable[..., Any]


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


def test_new_password_replaces_the_old(run: Run, database: Database) -> None:
    """And leaves an audit event."""
    run("user", "add", "ann")
    run("user", "password", "ann", "--password-stdin", stdin="another long password")
    with database.transaction() as tx:
        assert passwords.matches("another long password", users.get(tx, "ann").password_hash)
    assert kinds(database) == ["cli user_added", "cli password_set"]


def test_disabled_user_is_listed_as_such(run: Run) -> None:
    """And can be enabled again."""
    run("user", "add", "ann")
    assert run("user", "disable", "ann").out == "disabled user ann\n"
    assert run("user", "list").out.splitlines()[1].split() == ["ann", "user", "disabled"]
    assert run("user", "enable", "ann").status == 0
    assert run("user", "list").out.splitlines()[1].split() == ["ann", "user", "enabled"]


def test_grant_is_given_and_taken(run: Run, database: Database) -> None:
    """Each with its audit event; taking one that is not there fails."""
    run("user", "add", "ann")
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:01", "sim1")
    assert run("grant", "ann", "sim1", "drive").out == "user ann may drive robot sim1\n"
    with database.transaction() as tx:
        assert [seen.level for seen in robots.list_seen(tx, users.get(tx, "ann"))] == ["drive"]
    assert run("revoke", "ann", "sim1").status == 0
    done = run("revoke", "ann", "sim1")
    assert (done.status, done.err) == (
        1,
        "robotether: cannot revoke: user ann has no grant for robot sim1\n",
    )
    assert kinds(database) == ["cli user_added", "cli grant_given", "cli grant_taken"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("grant", "nobody", "sim1", "drive"), "cannot find user nobody"),
        (("grant", "ann", "ghost", "drive"), "cannot find robot ghost"),
        (("user", "password", "nobody"), "cannot find user nobody"),
        (("user", "disable", "nobody"), "cannot find user nobody"),
    ],
)
def test_unknown_names_are_said(
    run: Run, database: Database, arguments: tuple[str, ...], says: str
) -> None:
    """In one sentence with what to do."""
    run("user", "add", "ann")
    with database.transaction() as tx:
        robots.add(tx, "02:00:00:00:00:01", "sim1")
    done = run(*arguments)
    assert done.status == 1
    assert says in done.err


def test_unknown_level_says_which_there_are(run: Run) -> None:
    """A mistake in the arguments is exit status 2."""
    done = run("grant", "ann", "sim1", "fly")
    assert done.status == 2
    assert "'observe', 'drive', 'manage'" in done.err

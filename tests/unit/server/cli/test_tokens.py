"""robotether token."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from typing import Any

from robotether_server.db import Database, credentials

Run = Callable[..., Any]
CI = ("--user", "ann", "--name", "ci")


def test_token_is_the_last_word_of_the_last_line(run: Run, database: Database) -> None:
    """It works, and is neither listed nor audited afterwards."""
    run("user", "add", "ann")
    text = run("token", "create", *CI).out.splitlines()[-1].split()[-1]
    with database.transaction() as tx:
        user = credentials.find_token_user(tx, text)
        details = tx.rows("SELECT kind, details FROM audit_events")
    assert user is not None
    assert user.name == "ann"
    assert text not in str(details)
    assert details[-1]["kind"] == "token_created"
    listed = run("token", "list").out
    assert listed.splitlines()[1].split()[:2] == ["ann", "ci"]
    assert listed.split()[-1] == "never"
    assert text not in listed


def test_token_may_end(run: Run, database: Database) -> None:
    """After so many days."""
    run("user", "add", "ann")
    run("token", "create", *CI, "--days", "7")
    with database.transaction() as tx:
        [token] = credentials.list_tokens(tx)
    assert token.expires_at is not None
    assert dt.timedelta(days=6.9) < token.expires_at - token.created_at < dt.timedelta(days=7.1)


def test_deleted_token_works_no_more(run: Run, database: Database) -> None:
    """Deleting it twice says so; the name is free again."""
    run("user", "add", "ann")
    text = run("token", "create", *CI).out.split()[-1]
    assert "has one of that name" in run("token", "create", *CI).err
    assert run("token", "delete", *CI).status == 0
    with database.transaction() as tx:
        assert credentials.find_token_user(tx, text) is None
    assert "cannot delete token ci" in run("token", "delete", *CI).err
    assert run("token", "create", *CI).status == 0

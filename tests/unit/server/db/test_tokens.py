"""API tokens in the real database."""

from __future__ import annotations

import datetime as dt

import pytest
from robotether_server.db import Database, Transaction, tokens, users
from robotether_server.db.users import User
from robotether_server.problems import RecordExists, RecordMissing


def add_ann(tx: Transaction) -> User:
    users.add(tx, "ann", "x", "user")
    return users.get(tx, "ann")


def test_token_finds_its_user_until_deleted(database: Database) -> None:
    """The text begins with rt_ and stands in no table."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        text = tokens.create(tx, ann, "ci", None)
        assert text.startswith("rt_")
        assert tokens.find_user(tx, text) == ann
        assert text not in str(tx.rows("SELECT * FROM api_tokens"))
        assert [(one.user, one.name, one.expires_at) for one in tokens.list_all(tx)] == [
            ("ann", "ci", None)
        ]
        (token,) = tokens.list_of(tx, ann)
        assert tokens.get(tx, token.id) == token
        tokens.delete(tx, token.id)
        assert tokens.find_user(tx, text) is None
        with pytest.raises(RecordMissing, match=f"cannot find token {token.id}"):
            tokens.get(tx, token.id)


def test_token_ends_in_time(database: Database) -> None:
    """One that is over finds nobody."""
    now = dt.datetime.now(dt.UTC)
    with database.transaction() as tx:
        ann = add_ann(tx)
        over = tokens.create(tx, ann, "over", now - dt.timedelta(seconds=1))
        holds = tokens.create(tx, ann, "holds", now + dt.timedelta(hours=1))
        assert tokens.find_user(tx, over) is None
        assert tokens.find_user(tx, holds) == ann


def test_name_is_unique_for_a_user(database: Database) -> None:
    """Another user may use the same name."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        users.add(tx, "bob", "x", "user")
        tokens.create(tx, ann, "ci", None)
        tokens.create(tx, users.get(tx, "bob"), "ci", None)
        with pytest.raises(RecordExists, match="user ann has one of that name"):
            tokens.create(tx, ann, "ci", None)


def test_token_of_disabled_user_finds_nobody(database: Database) -> None:
    """A user who is out is out with every program."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        text = tokens.create(tx, ann, "ci", None)
        users.set_disabled(tx, ann.id, disabled=True)
        assert tokens.find_user(tx, text) is None

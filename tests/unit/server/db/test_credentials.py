"""Logins, API tokens and join tokens in the real database."""

from __future__ import annotations

import datetime as dt
import hashlib

import pytest
from allotment import at_once
from robotether_server.db import Database, Transaction, credentials, users
from robotether_server.db.users import User
from robotether_server.problems import RecordExists, RecordMissing


def test_texts_differ_and_are_long() -> None:
    """32 random bytes in URL-safe base64, after the prefix."""
    made = {credentials.new_secret("rt_") for _ in range(20)}
    assert len(made) == 20
    assert all(len(text) == 3 + 43 and text.startswith("rt_") for text in made)


def test_digest_is_sha256_of_the_whole_text() -> None:
    """As docs/reference/protocols.md says, so the relay finds the same row."""
    assert credentials.digest("rt_abc") == hashlib.sha256(b"rt_abc").digest()


def test_half_a_character_has_a_digest_of_its_own() -> None:
    """So bytes in a header that are no text are an unknown login, and not an error."""
    assert credentials.digest("\udcff") not in {credentials.digest(""), credentials.digest("?")}


HOUR = dt.timedelta(hours=1)


def test_login_holds_until_it_ends(database: Database) -> None:
    """The text finds its user, once ended no more; the table never holds the text."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        text = credentials.create_login(tx, users.get(tx, "ann"), "192.0.2.1", HOUR)
        found = credentials.find_login_user(tx, text)
        assert found is not None
        assert found.name == "ann"
        assert text not in str(tx.rows("SELECT * FROM logins"))
        assert credentials.find_login_user(tx, text + "x") is None
        assert credentials.end_login(tx, text)
        assert not credentials.end_login(tx, text)
        assert credentials.find_login_user(tx, text) is None


def test_login_that_is_over_holds_no_more_and_is_swept(database: Database) -> None:
    """The next login removes what is over."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        ann = users.get(tx, "ann")
        text = credentials.create_login(tx, ann, "", -HOUR)
        assert credentials.find_login_user(tx, text) is None
        credentials.create_login(tx, ann, "", HOUR)
        assert len(tx.rows("SELECT * FROM logins")) == 1


def test_login_of_disabled_user_does_not_hold(database: Database) -> None:
    """Even one that nobody removed."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        text = credentials.create_login(tx, users.get(tx, "ann"), "", HOUR)
        tx.change("UPDATE users SET disabled = TRUE")
        assert credentials.find_login_user(tx, text) is None


def add_ann(tx: Transaction) -> User:
    users.add(tx, "ann", "x", "user")
    return users.get(tx, "ann")


def test_token_finds_its_user_until_deleted(database: Database) -> None:
    """The text begins with rt_ and stands in no table."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        text = credentials.create_token(tx, ann, "ci", None)
        assert text.startswith("rt_")
        assert credentials.find_token_user(tx, text) == ann
        assert text not in str(tx.rows("SELECT * FROM api_tokens"))
        assert [(one.user, one.name, one.expires_at) for one in credentials.list_tokens(tx)] == [
            ("ann", "ci", None)
        ]
        (token,) = credentials.list_tokens_of(tx, ann)
        assert credentials.get_token(tx, token.id) == token
        credentials.delete_token(tx, token.id)
        assert credentials.find_token_user(tx, text) is None
        with pytest.raises(RecordMissing, match=f"cannot find token {token.id}"):
            credentials.get_token(tx, token.id)


def test_token_ends_in_time(database: Database) -> None:
    """One that is over finds nobody."""
    now = dt.datetime.now(dt.UTC)
    with database.transaction() as tx:
        ann = add_ann(tx)
        over = credentials.create_token(tx, ann, "over", now - dt.timedelta(seconds=1))
        holds = credentials.create_token(tx, ann, "holds", now + dt.timedelta(hours=1))
        assert credentials.find_token_user(tx, over) is None
        assert credentials.find_token_user(tx, holds) == ann


def test_name_is_unique_for_a_user(database: Database) -> None:
    """Another user may use the same name."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        users.add(tx, "bob", "x", "user")
        credentials.create_token(tx, ann, "ci", None)
        credentials.create_token(tx, users.get(tx, "bob"), "ci", None)
        with pytest.raises(RecordExists, match="user ann has one of that name"):
            credentials.create_token(tx, ann, "ci", None)


def test_token_of_disabled_user_finds_nobody(database: Database) -> None:
    """A user who is out is out with every program."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        text = credentials.create_token(tx, ann, "ci", None)
        users.set_disabled(tx, ann.id, disabled=True)
        assert credentials.find_token_user(tx, text) is None


NOW = dt.datetime.now(dt.UTC)
LATER = NOW + dt.timedelta(hours=1)


def test_token_is_found_by_its_text_alone(database: Database) -> None:
    """Which the database does not keep."""
    with database.transaction() as tx:
        text = credentials.create_join_token(tx, "lab", 3, LATER, "root")
        token = credentials.find_join_token(tx, text)
        assert token is not None
        assert text.startswith("rj_")
        assert (token.name, token.uses, token.used, token.created_by) == ("lab", 3, 0, "root")
        assert token.expires_at == LATER
        assert credentials.find_join_token(tx, text + "x") is None
        assert credentials.get_join_token(tx, token.id) == token
        assert text not in repr(tx.rows("SELECT * FROM join_tokens"))
        with pytest.raises(RecordExists, match="join token lab"):
            credentials.create_join_token(tx, "lab", 1, LATER, "root")


def test_each_key_uses_a_token_once(database: Database) -> None:
    """After the last use it lets nobody in; a deleted token is forgotten with its uses."""
    with database.transaction() as tx:
        token = credentials.find_join_token(
            tx, credentials.create_join_token(tx, "lab", 2, LATER, "root")
        )
        assert token is not None
        assert credentials.use_join_token(tx, token.id, "SHA256:a")
        assert credentials.has_admitted(tx, token.id, "SHA256:a")
        assert not credentials.has_admitted(tx, token.id, "SHA256:b")
        assert credentials.use_join_token(tx, token.id, "SHA256:b")
        assert not credentials.use_join_token(tx, token.id, "SHA256:c")
        assert credentials.get_join_token(tx, token.id).used == 2
        credentials.delete_join_token(tx, token.id)
        assert credentials.list_join_tokens(tx) == []
        assert not credentials.use_join_token(tx, token.id, "SHA256:d")
        with pytest.raises(RecordMissing, match="join token"):
            credentials.get_join_token(tx, token.id)


def test_token_whose_time_is_over_lets_nobody_in(database: Database) -> None:
    """Also one that ended while its robot was on the way."""
    with database.transaction() as tx:
        text = credentials.create_join_token(tx, "lab", 2, NOW - dt.timedelta(seconds=1), "root")
        token = credentials.find_join_token(tx, text)
        assert token is not None
        assert not credentials.use_join_token(tx, token.id, "SHA256:a")


def test_last_use_is_counted_once_when_many_ask_at_once(database: Database) -> None:
    """One wins, whoever it is."""
    with database.transaction() as tx:
        token = credentials.find_join_token(
            tx, credentials.create_join_token(tx, "lab", 1, LATER, "root")
        )
    assert token is not None
    won: list[int] = []

    def use(tx: Transaction, number: int) -> None:
        if credentials.use_join_token(tx, token.id, f"SHA256:{number}"):
            won.append(number)

    assert at_once(database, 8, use) == []
    assert len(won) == 1
    with database.transaction() as tx:
        assert credentials.get_join_token(tx, token.id).used == 1

"""Logins, API tokens and join tokens in the real database."""

import datetime as dt
import hashlib

import pytest
from robotether_server.db import credentials, users
from robotether_server.problems import TokenInvalidError


def test_texts_differ_and_are_long():
    made = {credentials.new_secret("rt_") for _ in range(20)}
    assert len(made) == 20
    assert all(len(text) == 3 + 43 and text.startswith("rt_") for text in made)


def test_digest_is_sha256_of_the_whole_text():
    assert credentials.digest("rt_abc") == hashlib.sha256(b"rt_abc").digest()


def test_half_a_character_has_a_digest_of_its_own():
    """So bytes in a header that are no text are an unknown login, and not an error."""
    assert credentials.digest("\udcff") not in {credentials.digest(""), credentials.digest("?")}


HOUR = dt.timedelta(hours=1)


def test_login_holds_until_it_ends(database):
    """The text finds its user, once ended no more; the table never holds the text."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        text = credentials.create_login(tx, users.get(tx, "ann"), "192.0.2.1", HOUR)
        found = credentials.find_login_user(tx, text)
        assert found.name == "ann"
        assert text not in str(tx.rows("SELECT * FROM logins"))
        assert credentials.find_login_user(tx, text + "x") is None
        assert credentials.end_login(tx, text)
        assert not credentials.end_login(tx, text)
        assert credentials.find_login_user(tx, text) is None


def test_login_that_is_over_holds_no_more_and_is_swept(database):
    """The next login removes what is over."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        ann = users.get(tx, "ann")
        text = credentials.create_login(tx, ann, "", -HOUR)
        assert credentials.find_login_user(tx, text) is None
        credentials.create_login(tx, ann, "", HOUR)
        assert len(tx.rows("SELECT * FROM logins")) == 1


def test_login_of_disabled_user_does_not_hold(database):
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        text = credentials.create_login(tx, users.get(tx, "ann"), "", HOUR)
        tx.change("UPDATE users SET disabled = TRUE")
        assert credentials.find_login_user(tx, text) is None


def add_ann(tx):
    users.add(tx, "ann", "x", "user")
    return users.get(tx, "ann")


def test_token_ends_in_time(database):
    """One that is over finds nobody."""
    now = dt.datetime.now(dt.UTC)
    with database.transaction() as tx:
        ann = add_ann(tx)
        over = credentials.create_token(tx, ann, "over", now - dt.timedelta(seconds=1))
        holds = credentials.create_token(tx, ann, "holds", now + dt.timedelta(hours=1))
        with pytest.raises(TokenInvalidError):
            credentials.get_token_user(tx, over)
        assert credentials.get_token_user(tx, holds) == ann


def test_token_of_disabled_user_finds_nobody(database):
    """A user who is out is out with every program."""
    with database.transaction() as tx:
        ann = add_ann(tx)
        text = credentials.create_token(tx, ann, "ci", None)
        users.set_disabled(tx, ann.id, disabled=True)
        with pytest.raises(TokenInvalidError):
            credentials.get_token_user(tx, text)

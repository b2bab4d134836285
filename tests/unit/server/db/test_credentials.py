"""Logins, API tokens and join tokens in the real database."""

import datetime as dt

import pytest
from robotether_server.db import credentials, join_tokens, users
from robotether_server.problems import TokenInvalidError


def test_texts_differ_and_are_long():
    made = {credentials.new_secret("rt_") for _ in range(20)}
    assert len(made) == 20
    assert all(len(text) == 3 + 43 and text.startswith("rt_") for text in made)


def test_half_a_character_has_a_digest_of_its_own():
    """So bytes in a header that are no text are an unknown login, and not an error."""
    assert credentials.digest("\udcff") not in {credentials.digest(""), credentials.digest("?")}


HOUR = dt.timedelta(hours=1)


@pytest.fixture
def tx(database):
    """A transaction in which there is ann."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        yield tx


@pytest.fixture
def ann(tx):
    return users.get(tx, "ann")


def test_login_holds_until_it_ends(tx, ann):
    """The text finds its user, once ended no more; the table never holds the text."""
    text = credentials.create_login(tx, ann, "192.0.2.1", HOUR)
    assert credentials.find_login_user(tx, text) == ann
    assert text not in str(tx.rows("SELECT * FROM logins"))
    assert credentials.find_login_user(tx, text + "x") is None
    assert credentials.end_login(tx, text)
    assert not credentials.end_login(tx, text)
    assert credentials.find_login_user(tx, text) is None


def test_login_that_is_over_holds_no_more_and_is_swept(tx, ann):
    """The next login removes what is over."""
    text = credentials.create_login(tx, ann, "", -HOUR)
    assert credentials.find_login_user(tx, text) is None
    credentials.create_login(tx, ann, "", HOUR)
    assert len(tx.rows("SELECT * FROM logins")) == 1


def test_token_ends_in_time(tx, ann):
    now = dt.datetime.now(dt.UTC)
    over = credentials.create_token(tx, ann, "over", now - dt.timedelta(seconds=1))
    holds = credentials.create_token(tx, ann, "holds", now + HOUR)
    with pytest.raises(TokenInvalidError):
        credentials.get_token_user(tx, over)
    assert credentials.get_token_user(tx, holds) == ann


def test_user_who_is_out_is_out_everywhere(tx, ann):
    login = credentials.create_login(tx, ann, "", HOUR)
    token = credentials.create_token(tx, ann, "ci", None)
    tx.change("UPDATE users SET disabled = TRUE")
    assert credentials.find_login_user(tx, login) is None
    with pytest.raises(TokenInvalidError):
        credentials.get_token_user(tx, token)


def test_join_token_whose_time_is_over_lets_nobody_in(tx):
    past = dt.datetime.now(dt.UTC) - dt.timedelta(seconds=1)
    token = join_tokens.find(tx, join_tokens.create(tx, "lab", 2, past, "root"))
    assert not join_tokens.use(tx, token.id, "SHA256:a")

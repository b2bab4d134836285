"""Logins, API tokens and join tokens in the real database."""

import datetime as dt

import pytest
from robotether_server.db import credentials, users


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
    """The text finds its user, once ended no more; the next login removes what is over."""
    over = credentials.create_login(tx, ann, "", -HOUR)
    assert credentials.find_login_user(tx, over) is None
    text = credentials.create_login(tx, ann, "192.0.2.1", HOUR)
    assert credentials.find_login_user(tx, text) == ann
    [row] = tx.rows("SELECT * FROM logins")
    assert (text in str(row), len(text)) == (False, 43)
    assert credentials.find_login_user(tx, text + "x") is None
    assert credentials.end_login(tx, text)
    assert not credentials.end_login(tx, text)
    assert credentials.find_login_user(tx, text) is None

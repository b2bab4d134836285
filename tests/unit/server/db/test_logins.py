"""Logins in the real database."""

from __future__ import annotations

import datetime as dt

from robotether_server.db import Database, logins, users

HOUR = dt.timedelta(hours=1)


def test_login_holds_until_it_ends(database: Database) -> None:
    """The text finds its user, once ended no more; the table never holds the text."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        text = logins.create(tx, users.get(tx, "ann"), "192.0.2.1", HOUR)
        found = logins.find_user(tx, text)
        assert found is not None
        assert found.name == "ann"
        assert text not in str(tx.rows("SELECT * FROM logins"))
        assert logins.find_user(tx, text + "x") is None
        assert logins.end(tx, text)
        assert not logins.end(tx, text)
        assert logins.find_user(tx, text) is None


def test_login_that_is_over_holds_no_more_and_is_swept(database: Database) -> None:
    """The next login removes what is over."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        ann = users.get(tx, "ann")
        text = logins.create(tx, ann, "", -HOUR)
        assert logins.find_user(tx, text) is None
        logins.create(tx, ann, "", HOUR)
        assert len(tx.rows("SELECT * FROM logins")) == 1


def test_login_of_disabled_user_does_not_hold(database: Database) -> None:
    """Even one that nobody removed."""
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        text = logins.create(tx, users.get(tx, "ann"), "", HOUR)
        tx.change("UPDATE users SET disabled = TRUE")
        assert logins.find_user(tx, text) is None

"""API tokens that are made and deleted."""

from __future__ import annotations

import datetime as dt

import pytest
from joins import Site
from robotether_server.db import credentials, users
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, NotPossible, RecordExists, RecordMissing
from robotether_server.services import tokens

ANN = Source("ann")


def test_token_works_until_it_is_deleted(site: Site) -> None:
    """The log names it and never has its text."""
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        text = tokens.create(tx, ANN, ann, "ci", None)
        tokens.create(tx, ANN, users.get(tx, "root"), "ci", dt.datetime.now(dt.UTC))
        (token,) = tokens.list_of(tx, ann)
        assert credentials.find_token_user(tx, text) == ann
        assert tokens.get(tx, token.id) == token
        assert [one.user for one in tokens.list_all(tx)] == ["ann", "root"]
        assert tokens.delete(tx, ANN, token.id).name == "ci"
        assert credentials.find_token_user(tx, text) is None
        with pytest.raises(RecordMissing):
            tokens.delete(tx, ANN, token.id)
    assert len(site.events("token_deleted")) == 1
    assert text not in repr(site.events("token_created"))


def test_wrong_or_taken_name_is_refused(site: Site) -> None:
    """A user's tokens have different names."""
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        tokens.create(tx, ANN, ann, "ci", None)
        with pytest.raises(RecordExists, match="user ann has one of that name"):
            tokens.create(tx, ANN, ann, "ci", None)
        with pytest.raises(FieldInvalid):
            tokens.create(tx, ANN, ann, "c\ni", None)


def test_nobody_fills_the_table(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each user has a bound of their own."""
    monkeypatch.setattr(tokens, "MAX_TOKENS", 1)
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        tokens.create(tx, ANN, ann, "first", None)
        with pytest.raises(NotPossible, match="user ann has 1"):
            tokens.create(tx, ANN, ann, "second", None)
        tokens.create(tx, ANN, users.get(tx, "root"), "first", None)

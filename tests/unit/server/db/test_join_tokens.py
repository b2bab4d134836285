"""Join tokens: found by their text, counted, and over."""

import datetime as dt

import pytest
from allotment import at_once
from robotether_server.db import join_tokens
from robotether_server.problems import RecordExistsError, RecordMissingError

NOW = dt.datetime.now(dt.UTC)
LATER = NOW + dt.timedelta(hours=1)


def test_token_is_found_by_its_text_alone(database):
    with database.transaction() as tx:
        text = join_tokens.create(tx, "lab", 3, LATER, "root")
        token = join_tokens.find(tx, text)
        assert text.startswith("rj_")
        assert (token.name, token.uses, token.used, token.created_by) == ("lab", 3, 0, "root")
        assert token.expires_at == LATER
        assert join_tokens.find(tx, text + "x") is None
        assert join_tokens.get(tx, token.id) == token
        assert text not in repr(tx.rows("SELECT * FROM join_tokens"))
        with pytest.raises(RecordExistsError, match="join token lab"):
            join_tokens.create(tx, "lab", 1, LATER, "root")


def test_each_key_uses_a_token_once(database):
    """After the last use it lets nobody in; a deleted token is forgotten with its uses."""
    with database.transaction() as tx:
        token = join_tokens.find(tx, join_tokens.create(tx, "lab", 2, LATER, "root"))
        assert join_tokens.use(tx, token.id, "SHA256:a")
        assert join_tokens.has_admitted(tx, token.id, "SHA256:a")
        assert not join_tokens.has_admitted(tx, token.id, "SHA256:b")
        assert join_tokens.use(tx, token.id, "SHA256:b")
        assert not join_tokens.use(tx, token.id, "SHA256:c")
        assert join_tokens.get(tx, token.id).used == 2
        join_tokens.delete(tx, token.id)
        assert join_tokens.list_all(tx) == []
        assert not join_tokens.use(tx, token.id, "SHA256:d")
        with pytest.raises(RecordMissingError, match="join token"):
            join_tokens.get(tx, token.id)


def test_token_whose_time_is_over_lets_nobody_in(database):
    with database.transaction() as tx:
        text = join_tokens.create(tx, "lab", 2, NOW - dt.timedelta(seconds=1), "root")
        token = join_tokens.find(tx, text)
        assert not join_tokens.use(tx, token.id, "SHA256:a")


def test_last_use_is_counted_once_when_many_ask_at_once(database):
    """One wins, whoever it is."""
    with database.transaction() as tx:
        token = join_tokens.find(tx, join_tokens.create(tx, "lab", 1, LATER, "root"))
    won = []

    def use(tx, number):
        if join_tokens.use(tx, token.id, f"SHA256:{number}"):
            won.append(number)

    assert at_once(database, 8, use) == []
    assert len(won) == 1
    with database.transaction() as tx:
        assert join_tokens.get(tx, token.id).used == 1

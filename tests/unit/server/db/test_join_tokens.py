"""Join tokens: found by their text, counted, and over."""

import datetime as dt

import pytest
from robotether_server.db import join_tokens
from robotether_server.problems import RecordExistsError

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


def test_token_whose_time_is_over_lets_nobody_in(database):
    with database.transaction() as tx:
        text = join_tokens.create(tx, "lab", 2, NOW - dt.timedelta(seconds=1), "root")
        token = join_tokens.find(tx, text)
        assert not join_tokens.use(tx, token.id, "SHA256:a")

"""API tokens and join tokens: who makes them, and what lets a robot in."""

import datetime as dt

import pytest
from api_visitor import new_public_key
from robotether_server.db import credentials, join_tokens, users
from robotether_server.db.audit import Source
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    NotPossibleError,
    RecordExistsError,
)
from robotether_server.services import ssh_keys, tokens

ANN, ADMIN = Source("ann"), Source("root")


def test_text_of_a_login_or_token_is_in_no_table(site):
    tables = ("logins", "api_tokens", "join_tokens")
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        texts = [credentials.create_login(tx, ann, "192.0.2.1", dt.timedelta(hours=1))]
        texts.append(tokens.create(tx, ANN, ann, "ci", None))
        texts.append(tokens.create_join_token(tx, ADMIN, "lab", 10000, hours(8760)))
        rows = [tx.rows(f"SELECT * FROM {table}") for table in tables]
    assert not [text for text in texts if text in repr((rows, site.events()))]


def test_half_a_character_has_a_digest_of_its_own():
    """So bytes in a header that are no text are an unknown login, and not an error."""
    assert credentials.digest("\udcff") not in {credentials.digest(""), credentials.digest("?")}


def test_what_a_token_made_goes_with_it(site):
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        program = Source(
            "ann", api_token=credentials.digest(tokens.create(tx, ANN, ann, "ci", None))
        )
        with pytest.raises(GrantMissingError, match="an API token makes no other"):
            tokens.create(tx, program, ann, "next", None)
        for source, name in ((ANN, "by hand"), (program, "by program")):
            tokens.create_join_token(tx, source, name, 1, hours(1))
            ssh_keys.add(tx, source, ann, name, new_public_key())
        (token,) = credentials.list_tokens_of(tx, ann)
        tokens.delete(tx, ANN, token.id)
        assert [item.name for item in join_tokens.list_all(tx)] == ["by hand"]
        assert [key.name for key in users.list_ssh_keys(tx, ann)] == ["by hand"]
    for kind in ("join_token_deleted", "ssh_key_deleted", "token_deleted"):
        assert len(site.events(kind)) == 1


def test_wrong_or_taken_name_or_one_too_many_is_refused(site, monkeypatch):
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        tokens.create(tx, ANN, ann, "ci", None)
        with pytest.raises(RecordExistsError, match="user ann has one of that name"):
            tokens.create(tx, ANN, ann, "ci", None)
        with pytest.raises(FieldInvalidError):
            tokens.create(tx, ANN, ann, "c\ni", None)
        with pytest.raises(FieldInvalidError):
            tokens.create_join_token(tx, ADMIN, " lab", 1, hours(1))
        # Nobody fills the table.
        monkeypatch.setattr(tokens, "MAX_TOKENS", 1)
        with pytest.raises(NotPossibleError, match="user ann has 1"):
            tokens.create(tx, ANN, ann, "second", None)
        tokens.create(tx, ANN, users.get(tx, "root"), "first", None)


def hours(count):
    return dt.datetime.now(dt.UTC) + dt.timedelta(hours=count)

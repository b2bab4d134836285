"""Join tokens that admins make."""

from __future__ import annotations

import datetime as dt

import pytest
from joins import Site
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, RecordMissing
from robotether_server.services import join_tokens

ADMIN = Source("root")


def hours(count: float) -> dt.datetime:
    return dt.datetime.now(dt.UTC) + dt.timedelta(hours=count)


def test_token_is_made_listed_and_deleted(site: Site) -> None:
    """The log names it and never has its text."""
    with site.database.transaction() as tx:
        text = join_tokens.create(tx, ADMIN, "lab", 10000, hours(8760))
        (token,) = join_tokens.list_all(tx)
        assert (token.name, token.uses, token.created_by) == ("lab", 10000, "root")
        assert join_tokens.delete(tx, ADMIN, token.id) == token
        with pytest.raises(RecordMissing):
            join_tokens.delete(tx, ADMIN, token.id)
    events = site.events("join_token_created") + site.events("join_token_deleted")
    assert len(events) == 2
    assert text not in repr(events)


@pytest.mark.parametrize(
    ("name", "uses", "end"),
    [
        ("", 1, 1),
        (" lab", 1, 1),
        ("l\nab", 1, 1),
        ("x" * 64, 1, 1),
        ("lab", 0, 1),
        ("lab", 10001, 1),
        ("lab", 1, 0),
        ("lab", 1, -1),
        ("lab", 1, 8761),
    ],
)
def test_wrong_token_is_not_made(site: Site, name: str, uses: int, end: float) -> None:
    """A name that fits a table, 1 to 10000 uses, an end within a year."""
    with site.database.transaction() as tx, pytest.raises(FieldInvalid):
        join_tokens.create(tx, ADMIN, name, uses, hours(end))

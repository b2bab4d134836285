"""Groups of users in the real database."""

from __future__ import annotations

import pytest
from robotether_server.db import Database, groups, users
from robotether_server.db.groups import Group
from robotether_server.problems import RecordExists, RecordMissing


def test_group_has_members_by_name(database: Database) -> None:
    """A second time changes nothing; who leaves is no member."""
    with database.transaction() as tx:
        crew, empty = groups.add(tx, "crew"), groups.add(tx, "a-team")
        ids = {name: users.add(tx, name, "x", "user") for name in ("zoe", "ann")}
        assert [groups.add_member(tx, crew, ids[name]) for name in ("zoe", "ann", "ann")] == [
            True,
            True,
            False,
        ]
        assert groups.list_all(tx) == [
            Group(empty, "a-team", ()),
            Group(crew, "crew", ("ann", "zoe")),
        ]
        assert groups.remove_member(tx, crew, ids["ann"])
        assert not groups.remove_member(tx, crew, ids["ann"])
        users.remove(tx, ids["zoe"])
        assert groups.get(tx, "crew") == Group(crew, "crew", ())
        groups.remove(tx, crew)
        with pytest.raises(RecordMissing, match="cannot find group crew"):
            groups.get(tx, "crew")


def test_name_is_had_once(database: Database) -> None:
    """The sentence says which."""
    with database.transaction() as tx:
        groups.add(tx, "crew")
        with pytest.raises(RecordExists, match="cannot add group crew: the name is taken"):
            groups.add(tx, "crew")

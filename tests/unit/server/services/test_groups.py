"""Groups that admins make and fill."""

from __future__ import annotations

import pytest
from joins import Site
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, RecordMissing
from robotether_server.services import groups

ADMIN = Source("root")


def test_each_change_is_in_the_log_once(site: Site) -> None:
    """Who is a member already stays one without a line."""
    with site.database.transaction() as tx:
        groups.add(tx, ADMIN, "crew")
        for _ in range(2):
            assert groups.add_member(tx, ADMIN, "crew", "ann").members == ("ann",)
        assert groups.remove_member(tx, ADMIN, "crew", "ann").members == ()
        with pytest.raises(RecordMissing, match="user ann from group crew: the user is no member"):
            groups.remove_member(tx, ADMIN, "crew", "ann")
        groups.add_member(tx, ADMIN, "crew", "ann")
        assert groups.remove(tx, ADMIN, "crew").members == ("ann",)
    counts = {
        kind: len(site.events(kind))
        for kind in ("group_added", "group_member_added", "group_member_removed", "group_removed")
    }
    assert counts == {
        "group_added": 1,
        "group_member_added": 2,
        "group_member_removed": 1,
        "group_removed": 1,
    }


@pytest.mark.parametrize("name", ["", "A", "a b", ".a", "x" * 64])
def test_name_must_fit_a_path(site: Site, name: str) -> None:
    """The sentence says how."""
    with site.database.transaction() as tx, pytest.raises(FieldInvalid, match="cannot use name"):
        groups.add(tx, ADMIN, name)

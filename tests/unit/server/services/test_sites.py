"""Sites that admins make, and robots that they put there."""

from __future__ import annotations

import pytest
from joins import Site
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, RecordMissing
from robotether_server.services import sites

ADMIN = Source("root")


def test_each_change_is_in_the_log_once(site: Site) -> None:
    """A robot that is there already stays without a line."""
    with site.database.transaction() as tx:
        sites.add(tx, ADMIN, "lab")
        for where in ("lab", "lab", None, "lab"):
            assert sites.place(tx, ADMIN, "sim1", where).site == where
        assert sites.remove(tx, ADMIN, "lab").robots == ("sim1",)
    kinds = ("site_added", "robot_site_set", "site_removed")
    assert [len(site.events(kind)) for kind in kinds] == [1, 3, 1]


def test_what_is_not_there_or_no_name_is_refused(site: Site) -> None:
    """The sentence says what."""
    with site.database.transaction() as tx:
        with pytest.raises(RecordMissing, match="cannot find site ghost"):
            sites.place(tx, ADMIN, "sim1", "ghost")
        with pytest.raises(RecordMissing, match="cannot find robot ghost"):
            sites.place(tx, ADMIN, "ghost", None)
        with pytest.raises(FieldInvalid, match="cannot use name"):
            sites.add(tx, ADMIN, "The Lab")

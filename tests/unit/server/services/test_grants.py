"""Grants, groups and sites: rules, and what the audit log tells."""

from __future__ import annotations

import pytest
from joins import Site
from robotether_server.db.audit import Source
from robotether_server.db.grants import Grant, list_all
from robotether_server.problems import FieldInvalidError, RecordMissingError
from robotether_server.services import grants
from robotether_server.services.grants import Grantee, Scope

ADMIN = Source("root")
ANN, SIM1 = Grantee("user", "ann"), Scope("robot", "sim1")


def test_grant_is_given_changed_and_taken(site: Site) -> None:
    """One a user and robot; each change is in the log."""
    with site.database.transaction() as tx:
        assert grants.give(tx, ADMIN, ANN, SIM1, "observe")[1]
        given, is_new = grants.give(tx, ADMIN, ANN, SIM1, "manage")
        assert not is_new
        assert given == Grant(given.id, "manage", user="ann", robot="sim1")
        assert grants.revoke_from(tx, ADMIN, ANN, SIM1) == given
        assert list_all(tx) == []
        with pytest.raises(RecordMissingError, match="user ann has no grant for robot sim1"):
            grants.revoke_from(tx, ADMIN, ANN, SIM1)
    assert (len(site.events("grant_given")), len(site.events("grant_taken"))) == (2, 1)


def test_each_change_of_a_group_is_in_the_log_once(site: Site) -> None:
    """Who is a member already stays one without a line."""
    with site.database.transaction() as tx:
        grants.add_group(tx, ADMIN, "crew")
        for _ in range(2):
            assert grants.add_member(tx, ADMIN, "crew", "ann").members == ("ann",)
        assert grants.remove_member(tx, ADMIN, "crew", "ann").members == ()
        with pytest.raises(
            RecordMissingError, match="user ann from group crew: the user is no member"
        ):
            grants.remove_member(tx, ADMIN, "crew", "ann")
        grants.add_member(tx, ADMIN, "crew", "ann")
        assert grants.remove_group(tx, ADMIN, "crew").members == ("ann",)
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


def test_each_change_of_a_site_is_in_the_log_once(site: Site) -> None:
    """A robot that is there already stays without a line."""
    with site.database.transaction() as tx:
        grants.add_site(tx, ADMIN, "lab")
        for where in ("lab", "lab", None, "lab"):
            assert grants.place_robot(tx, ADMIN, "sim1", where).site == where
        assert grants.remove_site(tx, ADMIN, "lab").robots == ("sim1",)
    kinds = ("site_added", "robot_site_set", "site_removed")
    assert [len(site.events(kind)) for kind in kinds] == [1, 3, 1]


def test_site_that_is_not_there_or_has_no_name_is_refused(site: Site) -> None:
    """The sentence says what."""
    with site.database.transaction() as tx:
        with pytest.raises(RecordMissingError, match="cannot find site ghost"):
            grants.place_robot(tx, ADMIN, "sim1", "ghost")
        with pytest.raises(RecordMissingError, match="cannot find robot ghost"):
            grants.place_robot(tx, ADMIN, "ghost", None)
        with pytest.raises(FieldInvalidError, match="cannot use name"):
            grants.add_site(tx, ADMIN, "The Lab")

"""Grants, groups and sites: rules, and what the audit log tells."""

import pytest
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, SITES, Grant, list_all
from robotether_server.problems import FieldInvalidError, RecordMissingError
from robotether_server.services import grants
from robotether_server.services.grants import Grantee, Scope

ADMIN = Source("root")
ANN, SIM1 = Grantee("user", "ann"), Scope("robot", "sim1")


def test_grant_is_given_changed_and_taken(site):
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


@pytest.mark.parametrize(
    ("collection", "member", "kinds"),
    [
        (GROUPS, "ann", ["group_member_added", "group_member_removed", "group_member_added"]),
        (SITES, "sim1", ["robot_site_set"] * 3),
    ],
)
def test_each_change_of_a_collection_is_in_the_log_once(site, collection, member, kinds):
    """Adding a member again changes nothing and leaves no line; removal names the members."""
    kind = collection.kind

    def set_member(*, to_be):
        if collection is GROUPS:
            change = grants.add_member if to_be else grants.remove_member
            change(tx, ADMIN, "x", member)
        else:
            grants.place_robot(tx, ADMIN, member, "x" if to_be else None)
        assert collection.get(tx, "x").members == ((member,) if to_be else ())

    with site.database.transaction() as tx:
        assert grants.add_collection(tx, ADMIN, collection, "x").name == "x"
        for to_be in (True, True, False, True):
            set_member(to_be=to_be)
        assert grants.remove_collection(tx, ADMIN, collection, "x").members == (member,)
        assert collection.list_all(tx) == []
    events = site.events()
    assert [event.kind for event in events] == [f"{kind}_added", *kinds, f"{kind}_removed"]
    assert events[0].details == {kind: "x"}
    assert events[-1].details == {kind: "x", collection.members: [member]}


def test_missing_member_and_invalid_name_are_refused(site):
    with site.database.transaction() as tx:
        grants.add_collection(tx, ADMIN, GROUPS, "crew")
        with pytest.raises(
            RecordMissingError, match="user ann from group crew: the user is no member"
        ):
            grants.remove_member(tx, ADMIN, "crew", "ann")
        with pytest.raises(RecordMissingError, match="cannot find site ghost"):
            grants.place_robot(tx, ADMIN, "sim1", "ghost")
        with pytest.raises(RecordMissingError, match="cannot find robot ghost"):
            grants.place_robot(tx, ADMIN, "ghost", None)
        with pytest.raises(FieldInvalidError, match="cannot use name"):
            grants.add_collection(tx, ADMIN, SITES, "The Lab")

"""Grants, groups and sites: rules, and what the audit log tells."""

import pytest
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.services import grants

ADMIN = Source("root")


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

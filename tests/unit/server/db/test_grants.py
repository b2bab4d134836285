"""Grants, groups and sites in the real database."""

import pytest
from robotether_server.db import grants, robots, users
from robotether_server.db.grants import GROUPS, SITES, Group, Site
from robotether_server.problems import RecordExistsError, RecordMissingError


@pytest.mark.parametrize(
    ("held", "asked", "may"),
    [
        ("observe", "observe", True),
        ("observe", "drive", False),
        ("drive", "observe", True),
        ("drive", "drive", True),
        ("drive", "manage", False),
        ("manage", "drive", True),
    ],
)
def test_level_includes_the_lower_ones(held, asked, may):
    """Who may drive may watch, and not the other way round."""
    assert grants.includes(held, asked) is may


def test_group_has_members_by_name(database):
    """Adding a member again changes nothing; users that leave or are removed are no members."""
    with database.transaction() as tx:
        crew, empty = GROUPS.add(tx, "crew"), GROUPS.add(tx, "a-team")
        ids = {name: users.add(tx, name, "x", "user") for name in ("zoe", "ann")}
        assert [grants.add_member(tx, crew, ids[name]) for name in ("zoe", "ann", "ann")] == [
            True,
            True,
            False,
        ]
        assert GROUPS.list_all(tx) == [
            Group(empty, "a-team", ()),
            Group(crew, "crew", ("ann", "zoe")),
        ]
        assert GROUPS.names(tx) == ["a-team", "crew"]
        assert grants.remove_member(tx, crew, ids["ann"])
        assert not grants.remove_member(tx, crew, ids["ann"])
        users.remove(tx, ids["zoe"])
        assert GROUPS.get(tx, "crew") == Group(crew, "crew", ())


@pytest.mark.parametrize("collection", [GROUPS, SITES])
def test_name_is_unique_and_must_exist(database, collection):
    """The sentences say which name of what is meant; another record of that name in the other collection is none."""
    kind = collection.kind
    with database.transaction() as tx:
        for each in (GROUPS, SITES):
            each.add(tx, "lab")
        with pytest.raises(RecordExistsError, match=f"cannot add {kind} lab: the name is taken"):
            collection.add(tx, "lab")
        collection.remove(tx, collection.get(tx, "lab").id)
        with pytest.raises(RecordMissingError, match=f"cannot find {kind} lab: .*: {kind} add lab"):
            collection.get(tx, "lab")
        assert len(GROUPS.names(tx) + SITES.names(tx)) == 1


def test_robot_is_at_one_site_or_none(database):
    """A site that is removed leaves its robots."""
    with database.transaction() as tx:
        lab, yard = SITES.add(tx, "lab"), SITES.add(tx, "yard")
        robot_id = robots.add(tx, "02:00:00:00:00:01", "a")
        for site in (yard, lab):
            grants.place_robot(tx, robot_id, site)
        assert SITES.list_all(tx) == [Site(lab, "lab", ("a",)), Site(yard, "yard", ())]
        assert robots.get(tx, "a").site == "lab"
        SITES.remove(tx, lab)
        assert robots.get(tx, "a").site is None
        grants.place_robot(tx, robot_id, yard)
        grants.place_robot(tx, robot_id, None)
        assert SITES.get(tx, "yard") == Site(yard, "yard", ())

"""Grants, groups and sites in the real database."""

from __future__ import annotations

import pytest
from robotether_server.db import Database, grants, robots, users
from robotether_server.db.grants import Group, Site
from robotether_server.problems import RecordExistsError, RecordMissingError
from robotether_server.schemas import Level


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
def test_level_includes_the_lower_ones(held: Level, asked: Level, may: bool) -> None:
    """Who may drive may watch, and not the other way round."""
    assert grants.includes(held, asked) is may


def test_group_has_members_by_name(database: Database) -> None:
    """A second time changes nothing; who leaves is no member."""
    with database.transaction() as tx:
        crew, empty = grants.add_group(tx, "crew"), grants.add_group(tx, "a-team")
        ids = {name: users.add(tx, name, "x", "user") for name in ("zoe", "ann")}
        assert [grants.add_member(tx, crew, ids[name]) for name in ("zoe", "ann", "ann")] == [
            True,
            True,
            False,
        ]
        assert grants.list_groups(tx) == [
            Group(empty, "a-team", ()),
            Group(crew, "crew", ("ann", "zoe")),
        ]
        assert grants.remove_member(tx, crew, ids["ann"])
        assert not grants.remove_member(tx, crew, ids["ann"])
        users.remove(tx, ids["zoe"])
        assert grants.get_group(tx, "crew") == Group(crew, "crew", ())
        grants.remove_group(tx, crew)
        with pytest.raises(RecordMissingError, match="cannot find group crew"):
            grants.get_group(tx, "crew")


def test_name_is_had_once_and_must_exist(database: Database) -> None:
    """The sentences say which."""
    with database.transaction() as tx:
        grants.add_group(tx, "crew")
        grants.add_site(tx, "lab")
        with pytest.raises(RecordExistsError, match="cannot add site lab: the name is taken"):
            grants.add_site(tx, "lab")
        with pytest.raises(RecordMissingError, match="cannot find site yard"):
            grants.get_site(tx, "yard")
        with pytest.raises(RecordExistsError, match="cannot add group crew: the name is taken"):
            grants.add_group(tx, "crew")


def test_robot_is_at_one_site_or_none(database: Database) -> None:
    """A site that goes leaves its robots."""
    with database.transaction() as tx:
        lab, yard = grants.add_site(tx, "lab"), grants.add_site(tx, "yard")
        robot_id = robots.add(tx, "02:00:00:00:00:01", "a")
        for site in (yard, lab):
            grants.place_robot(tx, robot_id, site)
        assert grants.list_sites(tx) == [Site(lab, "lab", ("a",)), Site(yard, "yard", ())]
        assert robots.get(tx, "a").site == "lab"
        grants.remove_site(tx, lab)
        assert robots.get(tx, "a").site is None
        grants.place_robot(tx, robot_id, yard)
        grants.place_robot(tx, robot_id, None)
        assert grants.get_site(tx, "yard") == Site(yard, "yard", ())

"""Grants, groups and sites in the real database."""

import pytest
from robotether_server.db import grants, robots
from robotether_server.db.grants import SITES, Site


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

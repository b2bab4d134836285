"""Sites of robots in the real database."""

from __future__ import annotations

import pytest
from robotether_server.db import Database, robots, sites
from robotether_server.db.sites import Site
from robotether_server.problems import RecordExists, RecordMissing


def test_robot_is_at_one_site_or_none(database: Database) -> None:
    """A site that goes leaves its robots."""
    with database.transaction() as tx:
        lab, yard = sites.add(tx, "lab"), sites.add(tx, "yard")
        robot_id = robots.add(tx, "02:00:00:00:00:01", "a")
        for site in (yard, lab):
            sites.place(tx, robot_id, site)
        assert sites.list_all(tx) == [Site(lab, "lab", ("a",)), Site(yard, "yard", ())]
        assert robots.get(tx, "a").site == "lab"
        sites.remove(tx, lab)
        assert robots.get(tx, "a").site is None
        sites.place(tx, robot_id, yard)
        sites.place(tx, robot_id, None)
        assert sites.get(tx, "yard") == Site(yard, "yard", ())


def test_name_is_had_once_and_must_exist(database: Database) -> None:
    """The sentences say which."""
    with database.transaction() as tx:
        sites.add(tx, "lab")
        with pytest.raises(RecordExists, match="cannot add site lab: the name is taken"):
            sites.add(tx, "lab")
        with pytest.raises(RecordMissing, match="cannot find site yard"):
            sites.get(tx, "yard")

"""robotether site ..."""

from __future__ import annotations

import json

from admin_records import Run, kinds, robot
from robotether_server.db import Database


def test_site_is_added_filled_listed_and_removed(run: Run, database: Database) -> None:
    """Each with its line in the log."""
    run("robot", "add", "sim1", "--mac", "00:1b:44:11:3a:b7")
    assert run("site", "add", "lab").out == "added site lab\n"
    assert run("site", "list").out.splitlines()[1].split() == ["lab", "-"]
    assert run("site", "place", "sim1", "lab").out == "robot sim1 is at site lab\n"
    assert robot(database).site == "lab"
    assert json.loads(run("site", "list", "--json").out) == [{"name": "lab", "robots": ["sim1"]}]
    assert run("site", "place", "sim1").out == "robot sim1 is at no site\n"
    assert "say --yes" in run("site", "remove", "lab").err
    assert run("site", "remove", "lab", "--yes").out == "removed site lab\n"
    assert kinds(database)[1:] == ["site_added", "robot_site_set", "robot_site_set", "site_removed"]

"""robotether group ..."""

from __future__ import annotations

import json

from admin_records import Run, kinds
from robotether_server.db import Database


def test_group_is_added_filled_listed_and_removed(run: Run, database: Database) -> None:
    """Each with its line in the log."""
    run("user", "add", "ann")
    assert run("group", "add", "crew").out == "added group crew\n"
    assert run("group", "join", "crew", "ann").out == "user ann is a member of group crew\n"
    assert run("group", "list").out.splitlines()[1].split() == ["crew", "ann"]
    assert json.loads(run("group", "list", "--json").out) == [{"name": "crew", "members": ["ann"]}]
    assert "no longer a member of group crew" in run("group", "leave", "crew", "ann").out
    assert run("group", "leave", "crew", "ann").status == 1
    assert "say --yes" in run("group", "remove", "crew").err
    assert run("group", "remove", "crew", terminal="y\n").status == 0
    assert kinds(database)[1:] == [
        "group_added",
        "group_member_added",
        "group_member_removed",
        "group_removed",
    ]

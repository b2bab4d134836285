"""robotether group ... and site ..."""

from __future__ import annotations

import json
from typing import NamedTuple

import pytest
from admin_records import kinds
from robotether_server.db.grants import GROUPS, SITES


class Change(NamedTuple):
    words: tuple[str, ...]
    printed: str
    kind: str


JOIN = Change(("join", "x", "ann"), "user ann is a member of group x", "group_member_added")
LEAVE = Change(
    ("leave", "x", "ann"), "user ann is no longer a member of group x", "group_member_removed"
)
PLACE = Change(("place", "ann", "x"), "robot ann is at site x", "robot_site_set")
REMOVE = Change(("place", "ann"), "robot ann is at no site", "robot_site_set")


@pytest.mark.parametrize(
    ("collection", "fill", "clear"), [(GROUPS, JOIN, LEAVE), (SITES, PLACE, REMOVE)]
)
def test_collection_is_added_filled_listed_and_removed(run, database, collection, fill, clear):
    """Each step says what it did and has its line in the log."""
    kind, members = collection.kind, collection.members
    run("user", "add", "ann")
    run("robot", "add", "ann", "--mac", "00:1b:44:11:3a:b7")
    assert run(kind, "add", "x").out == f"added {kind} x\n"
    assert run(kind, "list").out.splitlines()[1].split() == ["x", "-"]
    assert run(kind, *fill.words).out == f"{fill.printed}\n"
    assert run(kind, "list").out.splitlines()[1].split() == ["x", "ann"]
    assert json.loads(run(kind, "list", "--json").out) == [{"name": "x", members: ["ann"]}]
    assert run(kind, *clear.words).out == f"{clear.printed}\n"
    assert "say --yes" in run(kind, "remove", "x").err
    assert run(kind, "remove", "x", terminal="n\n").status == 1
    assert run(kind, "remove", "x", terminal="y\n").out.endswith(f"removed {kind} x\n")
    assert run(kind, "remove", "x", "--yes").status == 1
    assert kinds(database)[2:] == [f"{kind}_added", fill.kind, clear.kind, f"{kind}_removed"]

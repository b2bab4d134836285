"""robotether group ... and site ..."""

import json

import pytest
from robotether_server.db.grants import GROUPS, SITES

JOIN = ("join x ann", "user ann is a member of group x")
LEAVE = ("leave x ann", "user ann is no longer a member of group x")
PLACE = ("place ann x", "robot ann is at site x")
REMOVE = ("place ann", "robot ann is at no site")


@pytest.mark.parametrize(
    ("collection", "fill", "clear"), [(GROUPS, JOIN, LEAVE), (SITES, PLACE, REMOVE)]
)
def test_collection_is_added_filled_listed_and_removed(run, collection, fill, clear):
    """Each command prints its change, and a removal asks first."""
    kind, members = collection.kind, collection.members
    run("user", "add", "ann")
    run("robot", "add", "ann", "--mac", "00:1b:44:11:3a:b7")
    assert run(kind, "add", "x").out == f"added {kind} x\n"
    assert run(kind, "list").out.splitlines()[1].split() == ["x", "-"]
    assert run(kind, *fill[0].split()).out == f"{fill[1]}\n"
    assert run(kind, "list").out.splitlines()[1].split() == ["x", "ann"]
    assert json.loads(run(kind, "list", "--json").out) == [{"name": "x", members: ["ann"]}]
    assert run(kind, *clear[0].split()).out == f"{clear[1]}\n"
    assert "say --yes" in run(kind, "remove", "x").err
    assert run(kind, "remove", "x", terminal="n\n").status == 1
    assert run(kind, "remove", "x", terminal="y\n").out.endswith(f"removed {kind} x\n")
    assert run(kind, "remove", "x", "--yes").status == 1

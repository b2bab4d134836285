"""Grants, groups and sites through the API."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest
from api_visitor import Program

SOON = "2999-01-01T00:00:00Z"
UNSET = object()


def in_days(days: int) -> str:
    """A moment, as programs write it."""
    return (dt.datetime.now(dt.UTC) + dt.timedelta(days=days)).strftime("%Y-%m-%dT%H:%M:%SZ")


def test_grant_is_refused(root: Program) -> None:
    """Unknown users and robots, and what is no level."""
    for path in ("/grants/ghost/sim1", "/grants/ann/ghost"):
        assert root.refused("PUT", path, {"level": "drive"}) == (404, "record_missing")
        assert root.refused("DELETE", path) == (404, "record_missing")
    for body in ({}, {"level": "fly"}, {"level": "drive", "until": 1}):
        assert root.refused("PUT", "/grants/ann/sim1", body) == (422, "field_invalid")


def test_grant_of_a_group_for_a_site_is_each_members(root: Program, ann: Program) -> None:
    """Until she leaves the group; given again it takes the place of the first, and its number goes away with it."""
    root.ask("POST", "/groups", {"name": "crew"})
    root.ask("POST", "/sites", {"name": "lab"})
    root.ask("PATCH", "/robots/sim2", {"site": "lab"})
    root.ask("PUT", "/groups/crew/members/ann")
    body = {"group": "crew", "site": "lab", "level": "observe", "ends_at": in_days(1)}
    first = root.ask("POST", "/grants", body)
    again = root.ask("POST", "/grants", body | {"level": "manage"})
    assert (first.status_code, again.status_code) == (201, 200)
    assert first.json["id"] == again.json["id"]
    assert again.json["ends_at"] == body["ends_at"]
    assert ann.get("/robots/sim2")["level"] == "manage"
    root.ask("DELETE", "/groups/crew/members/ann")
    assert ann.refused("GET", "/robots/sim2") == (404, "robot_unknown")
    assert root.ask("DELETE", f"/grants/{first.json['id']}").status_code == 204
    assert root.refused("DELETE", f"/grants/{first.json['id']}") == (404, "record_missing")


@pytest.mark.parametrize(
    "change",
    [
        {"group": "crew"},
        {"user": None},
        {"site": "lab"},
        {"all": True},
        {"robot": None},
        {"ends_at": "2020-01-01T00:00:00Z"},
        {"ends_at": SOON},
        {"ends_at": "2026-01-31"},
        {"ends_at": 5},
        {"level": "own"},
        {"robot": UNSET},
        {"user": UNSET},
        # False is no way to say nothing.
        {"robot": UNSET, "all": False},
    ],
)
def test_grant_for_two_or_none_or_with_a_wrong_end_is_refused(root: Program, change: Any) -> None:
    """Exactly one holder, exactly one thing, and an end in the next ten years."""
    body = {"user": "ann", "robot": "sim1", "level": "drive"} | change
    given = {name: value for name, value in body.items() if value is not UNSET}
    assert root.refused("POST", "/grants", given) == (422, "field_invalid")


@pytest.mark.parametrize("name", ["", "Crew", "a b", "-a", "a/b", "x" * 64, "crew\n", None, 5])
def test_name_that_cannot_stand_in_a_path_is_refused(root: Program, name: object) -> None:
    """The rule for names is the one for users."""
    answer = root.ask("POST", "/groups", {"name": name})
    assert answer.status_code == (201 if name == "crew\n" else 422)


def test_what_is_not_there_is_said(root: Program) -> None:
    """Groups, users; and a name is had once."""
    root.ask("POST", "/groups", {"name": "crew"})
    assert root.refused("POST", "/groups", {"name": "crew"}) == (409, "record_exists")
    assert root.refused("PUT", "/groups/crew/members/ghost") == (404, "record_missing")
    assert root.refused("PUT", "/groups/ghost/members/ann") == (404, "record_missing")
    assert root.refused("GET", "/groups/crew%20") == (404, "record_missing")


def test_null_is_no_site(root: Program, ann: Program) -> None:
    """Whoever may see the robot sees where it is."""
    root.ask("POST", "/sites", {"name": "lab"})
    for site in ("lab", None):
        assert root.ask("PATCH", "/robots/sim1", {"site": site}).json["site"] == site
        assert ann.get("/robots/sim1")["site"] == site


def test_what_cannot_be_is_refused(root: Program) -> None:
    """Sites that are not there, names that are had or no good; nothing else of the PATCH is done."""
    root.ask("POST", "/sites", {"name": "lab"})
    assert root.refused("POST", "/sites", {"name": "lab"}) == (409, "record_exists")
    assert root.refused("POST", "/sites", {"name": "The Lab"}) == (422, "field_invalid")
    assert root.refused("DELETE", "/sites/ghost") == (404, "record_missing")
    body = {"site": "ghost", "shell": True}
    assert root.refused("PATCH", "/robots/sim1", body) == (404, "record_missing")
    assert root.refused("PATCH", "/robots/sim1", {"site": ["lab"]}) == (422, "field_invalid")
    assert root.get("/robots/sim1")["shell_port"] is None

"""Groups of users, as admins' programs keep them."""

from __future__ import annotations

import pytest
from api_visitor import Program


def test_group_is_added_filled_and_removed(root: Program) -> None:
    """A member twice is one; the users stay."""
    answer = root.ask("POST", "/groups", {"name": "crew"})
    assert (answer.status_code, answer.json["name"], answer.json["members"]) == (201, "crew", [])
    for _ in range(2):
        answer = root.ask("PUT", "/groups/crew/members/ann")
        assert (answer.status_code, answer.json["members"]) == (200, ["ann"])
    assert root.get("/groups")["groups"] == [root.get("/groups/crew")]
    assert root.ask("DELETE", "/groups/crew/members/ann").status_code == 204
    assert root.refused("DELETE", "/groups/crew/members/ann") == (404, "record_missing")
    assert root.ask("DELETE", "/groups/crew").status_code == 204
    assert root.refused("GET", "/groups/crew") == (404, "record_missing")
    assert root.get("/users/ann")["name"] == "ann"


@pytest.mark.parametrize("name", ["", "Crew", "a b", "-a", "a/b", "x" * 64, "crew\n", None, 5])
def test_name_that_cannot_stand_in_a_path_is_refused(root: Program, name: object) -> None:
    """As for users."""
    answer = root.ask("POST", "/groups", {"name": name})
    assert answer.status_code == (201 if name == "crew\n" else 422)


def test_what_is_not_there_is_said(root: Program) -> None:
    """Groups, users; and a name is had once."""
    root.ask("POST", "/groups", {"name": "crew"})
    assert root.refused("POST", "/groups", {"name": "crew"}) == (409, "record_exists")
    assert root.refused("PUT", "/groups/crew/members/ghost") == (404, "record_missing")
    assert root.refused("PUT", "/groups/ghost/members/ann") == (404, "record_missing")
    assert root.refused("GET", "/groups/crew%20") == (404, "record_missing")

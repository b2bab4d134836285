"""Grants, as admins give and take them."""

from __future__ import annotations

from api_visitor import Program


def test_grant_is_given_changed_and_taken(root: Program, ann: Program) -> None:
    """The user sees the robot as long as there is one."""
    answer = root.ask("PUT", "/grants/ann/sim2", {"level": "observe"})
    assert (answer.status_code, answer.json) == (
        200,
        {"user": "ann", "robot": "sim2", "level": "observe"},
    )
    root.ask("PUT", "/grants/ann/sim2", {"level": "manage"})
    assert ann.get("/robots/sim2")["level"] == "manage"
    assert {"user": "ann", "robot": "sim2", "level": "manage"} in root.get("/grants")["grants"]
    assert root.ask("DELETE", "/grants/ann/sim2").status_code == 204
    assert ann.refused("GET", "/robots/sim2") == (404, "robot_unknown")
    assert root.refused("DELETE", "/grants/ann/sim2") == (404, "record_missing")


def test_grant_is_refused(root: Program) -> None:
    """Unknown users and robots, and what is no level."""
    for path in ("/grants/ghost/sim1", "/grants/ann/ghost"):
        assert root.refused("PUT", path, {"level": "drive"}) == (404, "record_missing")
        assert root.refused("DELETE", path) == (404, "record_missing")
    for body in ({}, {"level": "fly"}, {"level": "drive", "until": 1}):
        assert root.refused("PUT", "/grants/ann/sim1", body) == (422, "field_invalid")

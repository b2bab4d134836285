"""What happened, as admins read it."""

from __future__ import annotations

import pytest
from api_visitor import Program


@pytest.fixture
def events(root: Program) -> list[dict[str, object]]:
    """Three events: sim1 gets a shell, sim2 gets one, sim1 loses it; the newest first."""
    for robot, shell in (("sim1", True), ("sim2", True), ("sim1", False)):
        root.ask("PATCH", f"/robots/{robot}", {"shell": shell})
    found: list[dict[str, object]] = root.get("/audit")["events"]
    return found


def test_events_are_told_in_full(events: list[dict[str, object]]) -> None:
    """Who, what, where from, when."""
    newest = events[0]
    assert (newest["actor"], newest["address"], newest["robot"]) == ("root", "198.51.100.7", "sim1")
    assert set(newest) == {"id", "at", "actor", "kind", "robot", "address", "details"}
    assert isinstance(newest["details"], dict)
    assert str(newest["at"]).endswith("Z")


def test_events_are_chosen_and_paged(root: Program, events: list[dict[str, object]]) -> None:
    """All filters together, and on from an id."""
    assert root.get("/audit?robot=sim1&actor=root")["events"] == [events[0], events[2]]
    assert root.get(f"/audit?kind={events[0]['kind']}&robot=sim2&actor=ann")["events"] == []
    assert root.get("/audit?limit=2")["events"] == events[:2]
    assert root.get(f"/audit?before={events[1]['id']}")["events"] == [events[2]]


@pytest.mark.parametrize(
    "query",
    [
        "limit=0",
        "limit=501",
        "limit=x",
        "before=0",
        "before=99999999999999999999",
        "robots=sim1",
        "robot=",
        f"kind={'x' * 41}",
        "robot=sim1&robot=sim2",
    ],
)
def test_wrong_query_is_refused(root: Program, query: str) -> None:
    """A filter that nobody reads would show more than was asked for."""
    assert root.refused("GET", f"/audit?{query}") == (422, "field_invalid")

"""Sites of robots, as admins' programs keep them."""

from __future__ import annotations

from api_visitor import Program


def test_site_is_added_and_robots_are_put_there(root: Program, ann: Program) -> None:
    """Whoever may see the robot sees where it is; null is no site."""
    answer = root.ask("POST", "/sites", {"name": "lab"})
    assert (answer.status_code, answer.json["robots"]) == (201, [])
    assert root.ask("PATCH", "/robots/sim1", {"site": "lab"}).json["site"] == "lab"
    assert ann.get("/robots/sim1")["site"] == "lab"
    assert root.get("/sites")["sites"] == [root.get("/sites/lab")]
    assert root.get("/sites/lab")["robots"] == ["sim1"]
    assert root.ask("PATCH", "/robots/sim1", {"site": None}).json["site"] is None
    root.ask("PATCH", "/robots/sim1", {"site": "lab"})
    assert root.ask("DELETE", "/sites/lab").status_code == 204
    assert ann.get("/robots/sim1")["site"] is None


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

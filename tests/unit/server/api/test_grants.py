"""Grants, groups and sites through the API."""

import datetime as dt


def in_days(days):
    return (dt.datetime.now(dt.UTC) + dt.timedelta(days=days)).strftime("%Y-%m-%dT%H:%M:%SZ")


def test_grant_of_a_group_for_a_site_is_each_members(root, ann):
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


def test_grant_for_two_or_none_is_refused(root):
    """A grant has exactly one holder and exactly one scope; False is no way to say nothing."""
    who, what = {"user": "ann"}, {"robot": "sim1"}
    for body in (
        who | what | {"site": "lab"},
        who | what | {"all": True},
        who,
        what,
        who | {"all": False},
    ):
        assert root.refused("POST", "/grants", body | {"level": "drive"}) == (422, "field_invalid")


def test_null_is_no_site(root, ann):
    """Whoever may see the robot sees where it is."""
    root.ask("POST", "/sites", {"name": "lab"})
    for site in ("lab", None):
        assert root.ask("PATCH", "/robots/sim1", {"site": site}).json["site"] == site
        assert ann.get("/robots/sim1")["site"] == site

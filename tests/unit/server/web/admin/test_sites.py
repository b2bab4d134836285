"""The pages of sites."""

from __future__ import annotations

import datetime as dt

from admin_visitor import send
from robotether_server.db import Database, join_tokens, robots
from robotether_server.db.join_tokens import Place
from web_visitor import Browser, audit_kinds


def site_of(database: Database, robot: str) -> str | None:
    """Where a robot is."""
    with database.transaction() as tx:
        return robots.get(tx, robot).site


def test_site_is_added_filled_and_removed(admin: Browser, database: Database) -> None:
    """A site is added from its own page and from the robot's."""
    assert "There is no site yet" in admin.ask("GET", "/admin/robots/sim1").text
    assert send(admin, "/admin/sites", name="lab").location == "/admin/sites/lab"
    assert send(admin, "/admin/sites/lab/robots", robot="sim1").location == "/admin/sites/lab"
    assert site_of(database, "sim1") == "lab"
    assert "/admin/sites/lab" in admin.ask("GET", "/admin/robots?q=lab").text
    assert send(admin, "/admin/robots/sim1/site", site="").location == "/admin/robots/sim1"
    assert site_of(database, "sim1") is None
    send(admin, "/admin/robots/sim2/site", site="lab")
    assert "sim2" in admin.ask("GET", "/admin/sites").text
    assert "Its robots stay, at no site: sim2." in admin.ask("GET", "/admin/sites/lab/remove").text
    assert send(admin, "/admin/sites/lab/remove").location == "/admin/sites"
    assert site_of(database, "sim2") is None
    kinds = [kind for kind, *_ in audit_kinds(database)]
    assert kinds[-5:] == ["site_added", *["robot_site_set"] * 3, "site_removed"]


def test_who_removes_a_site_or_group_reads_which_join_tokens_lose_it(
    admin: Browser, database: Database
) -> None:
    """Those that can still admit a robot; without any, nothing is said of them."""
    now = dt.datetime.now(dt.UTC)
    later, past = (now + dt.timedelta(hours=hours) for hours in (1, -1))
    places = {"/admin/sites": Place(site="lab"), "/admin/groups": Place(group="crew")}
    for path, place in places.items():
        name = place.site or place.group or ""
        send(admin, path, name=name)
        page = f"{path}/{name}/remove"
        assert "these tokens" not in admin.ask("GET", page).text
        with database.transaction() as tx:
            for token, ends_at in (("b", later), ("<a>", later), ("old", past)):
                label = f"{name} {token}"
                join_tokens.create(tx, label, 1, ends_at, "root", place=place)
            join_tokens.create(tx, f"{name} elsewhere", 1, later, "root")
        assert f": {name} &lt;a&gt;, {name} b.<" in admin.ask("GET", page).text


def test_robot_is_taken_out_after_a_question(admin: Browser, database: Database) -> None:
    """Which says what is lost by it; a robot that is not there by then is said."""
    send(admin, "/admin/sites", name="lab")
    send(admin, "/admin/sites/lab/robots", robot="sim1")
    path = "/admin/sites/lab/robots/sim1/take-out"
    assert f'href="{path}"' in admin.ask("GET", "/admin/sites/lab").text
    assert "the grants for site lab" in admin.ask("GET", path).text
    assert site_of(database, "sim1") == "lab"
    assert send(admin, path).location == "/admin/sites/lab"
    assert site_of(database, "sim1") is None
    answer = send(admin, path)
    assert (answer.status_code, "it is not there" in answer.text) == (409, True)
    assert send(admin, "/admin/sites/lab/robots/ghost/take-out").status_code == 404

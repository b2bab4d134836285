"""The page of routes, and the same by the API."""

import pytest
from api_visitor import program_of
from granted import give
from robotether_server.db import robots, users

TWIST = "geometry_msgs/msg/Twist"
BODY = {
    "source": "sim1",
    "source_topic": "/cmd_vel",
    "target": "sim2",
    "target_topic": "cmd_vel",
    "type": TWIST,
}


@pytest.fixture
def both(manager, database):
    """May manages sim2, too."""
    with database.transaction() as tx:
        for name in ("sim1", "sim2"):
            robots.set_state(tx, robots.get(tx, name).id, "active")
        give(tx, users.get(tx, "may").id, robots.get(tx, "sim2").id, "manage")
    return manager


def sent(browser, start, end, **more):
    form = {
        "csrf_token": browser.csrf_of("/routes"),
        "from": start,
        "to": end,
        "rate_hz": "20",
        **more,
    }
    return browser.ask("POST", "/routes", data=form, follow_redirects=True)


def test_the_form_makes_a_route_and_the_list_removes_it(both):
    page = sent(both, f"sim1 /cmd_vel {TWIST}", f"sim2 /cmd_vel {TWIST}", hours="2").text
    assert "The route from sim1 to sim2 is made." in page
    assert 'data-target-topic="/cmd_vel" data-lasts' in page
    number = page.partition('data-route="')[2].partition('"')[0]
    form = {"csrf_token": both.csrf_of("/routes")}
    page = both.ask("POST", f"/routes/{number}/remove", data=form, follow_redirects=True).text
    assert "There are none" in page


def test_markup_is_text_everywhere(both):
    """A robot names its topics and types itself."""
    page = sent(both, "sim1 /a <b>x</b>", "sim2 /a <b>x</b>").text
    assert "<code>/a</code>" in page
    wrong = sent(both, "sim1 /<script>x</script> t", "sim2 /a t").text
    assert "<script>x" not in wrong
    assert "it must be a topic" in wrong


def test_types_that_differ_are_refused(both):
    page = sent(both, f"sim1 /cmd_vel {TWIST}", "sim2 /odom nav_msgs/msg/Odometry")
    assert page.status_code == 422
    assert "/odom nav_msgs/msg/Odometry" in page.text


def test_who_manages_one_robot_is_offered_no_route(manager):
    assert "You need two robots" in manager.ask("GET", "/routes").text


def test_the_api_makes_lists_and_removes(both, program, database):
    may, ann = (program_of(program, database, name) for name in ("may", "ann"))
    made = may.ask("POST", "/routes", BODY)
    assert made.status_code == 201
    assert (made.json["target_topic"], made.json["rate_hz"], made.json["made_by"]) == (
        "/cmd_vel",
        20,
        "may",
    )
    assert may.get("/routes")["routes"] == [made.json]
    assert ann.get("/routes")["routes"] == []
    assert ann.refused("POST", "/routes", BODY) == (403, "grant_missing")
    path = f"/routes/{made.json['id']}"
    assert ann.refused("DELETE", path) == (404, "record_missing")
    assert may.ask("DELETE", path).status_code == 204

"""Requests for help over the API, by programs and by people with a login."""

from api_visitor import in_person
from robotether_server.db import robots


def test_the_requests_of_a_robot_that_is_not_seen_are_not_none(ann, root):
    """A name with a mistake in it would else read as a robot that needs nobody."""
    for robot in ("sim9", "sim2"):
        assert ann.refused("GET", f"/requests?robot={robot}") == (404, "robot_unknown")
    assert ann.get("/requests?robot=sim1") == root.get("/requests?robot=sim2") == {"requests": []}


def test_a_note_is_one_line_and_no_markup(ann, database):
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "sim1").id, "active")
        tx.change("UPDATE planner SET planned_at = planned_at - INTERVAL 1 MINUTE")
    number = ann.ask("POST", "/robots/sim1/requests", {"reason": "stuck"}).json["id"]
    ann.ask("PUT", "/queue/me", {"state": "available"})
    assert ann.ask("POST", f"/requests/{number}/accept").json["drive_url"] == "/robots/sim1"
    closed = ann.ask("POST", f"/requests/{number}/close", {"note": "  a\n<i>b</i> "}).json
    assert closed["note"] == "a <i>b</i>"


def test_a_page_that_polls_keeps_no_login_alive(browser, database):
    """The login idles on; what a person does renews it."""
    ann = in_person(browser, "ann")

    def make_old():
        with database.transaction() as tx:
            tx.change("UPDATE logins SET expires_at = expires_at - INTERVAL 1 HOUR")

    def ends_at():
        with database.transaction() as tx:
            return tx.row("SELECT expires_at FROM logins")["expires_at"]

    make_old()
    old = ends_at()
    assert ann.ask("PUT", "/queue/me", {}).status_code == 200
    assert ann.ask("GET", "/requests").status_code == 200
    assert ends_at() == old
    ann.ask("GET", "/me")
    assert ends_at() > old

"""Requests for help over the API, by programs and by people with a login."""

import pytest
from api_visitor import in_person
from robotether_server.db import robots


@pytest.fixture
def sim1(database, app):
    assert app
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "sim1").id, "active")
        tx.change("UPDATE planner SET planned_at = planned_at - INTERVAL 1 MINUTE")


@pytest.mark.usefixtures("sim1")
def test_a_request_goes_from_the_question_to_the_note(ann, root):
    made = ann.ask("POST", "/robots/sim1/requests", {"reason": "<b>stuck</b>", "pool": ""})
    assert made.status_code == 201
    request = made.json
    assert (request["reason"], request["priority"], request["state"]) == (
        "<b>stuck</b>",
        2,
        "waiting",
    )
    path = f"/requests/{request['id']}"
    view = ann.ask("PUT", "/queue/me", {"state": "available"}).json
    assert (view["state"], view["offer"]["id"], view["current"]) == (
        "available",
        request["id"],
        None,
    )
    assert root.refused("POST", f"{path}/accept") == (409, "not_possible")
    accepted = ann.ask("POST", f"{path}/accept").json
    assert (accepted["drive_url"], accepted["request"]["accepted_by"]) == ("/robots/sim1", "ann")
    operators = root.get("/operators")["operators"]
    assert [(operator["user"], operator["state"]) for operator in operators] == [("ann", "busy")]
    assert root.get("/requests?robot=sim1")["requests"][0]["id"] == request["id"]
    closed = ann.ask("POST", f"{path}/close", {"note": "  a\n<i>b</i> "}).json
    assert (closed["state"], closed["note"]) == ("closed", "a <i>b</i>")
    assert ann.get("/requests")["requests"] == []
    assert ann.get("/requests?state=closed")["requests"] == [closed]
    assert ann.get("/requests/figures?hours=1")["answered"] == 1


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/robots/sim1/requests", {"reason": ""}),
        ("POST", "/robots/sim1/requests", {"reason": "x" * 201}),
        ("POST", "/robots/sim1/requests", {"reason": "a\nb"}),
        ("POST", "/robots/sim1/requests", {"reason": "x", "priority": 0}),
        ("POST", "/robots/sim1/requests", {"reason": "x", "pool": "No Pool"}),
        ("POST", "/requests/1/close", {"note": "x" * 501}),
        ("PUT", "/queue/me", {"state": "busy"}),
    ],
)
def test_what_no_request_may_say_is_refused(ann, method, path, body):
    assert ann.refused(method, path, body) == (422, "field_invalid")


def test_pools_are_set_by_admins(ann, root):
    assert ann.refused("PUT", "/users/ann/pools", {"pools": []})[0] == 403
    answer = root.ask("PUT", "/users/ann/pools", {"pools": ["night", "crane", "night"]})
    assert answer.json == root.get("/users/ann/pools") == {"pools": ["crane", "night"]}
    assert root.refused("PUT", "/users/ann/pools", {"pools": ["<b>"]}) == (422, "field_invalid")
    assert root.refused("PUT", "/users/ghost/pools", {"pools": []}) == (404, "record_missing")
    [event] = root.get("/audit?kind=user_pools_set")["events"]
    assert event["details"] == {"user": "ann", "was": [], "pools": ["crane", "night"]}


def test_operators_are_for_managers(ann):
    assert ann.refused("GET", "/operators") == (403, "grant_missing")


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

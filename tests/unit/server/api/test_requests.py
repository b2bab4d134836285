"""Requests for help over the API, by programs and by people with a login."""

from robotether_server.db import robots

MAC, OTHER_MAC = "02:00:00:00:51:01", "02:00:00:00:51:02"


def test_the_requests_of_a_robot_that_is_not_seen_are_not_none(ann, root):
    """A name with a mistake in it would else read as a robot that needs nobody."""
    for robot in ("sim9", "sim2", f"sim1&mac={OTHER_MAC}"):
        assert ann.refused("GET", f"/requests?robot={robot}") == (404, "robot_unknown")
    assert ann.get("/requests?robot=sim1") == root.get("/requests?robot=sim2") == {"requests": []}


def test_a_note_is_one_line_and_no_markup(ann, database):
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "sim1").id, "active")
        tx.change("UPDATE planner SET planned_at = planned_at - INTERVAL 1 MINUTE")
    asked, again = (ann.ask("POST", "/robots/sim1/requests", {"reason": why}) for why in "ab")
    assert (asked.status_code, again.status_code) == (201, 200)
    assert (again.json["id"], again.json["reason"]) == (asked.json["id"], "a")
    number = asked.json["id"]
    for mac, listed in ((MAC, [number]), (OTHER_MAC, [])):
        assert [each["id"] for each in ann.get(f"/requests?mac={mac}")["requests"]] == listed
    ann.ask("PUT", "/queue/me", {"state": "available"})
    assert ann.ask("POST", f"/requests/{number}/accept").json["drive_url"] == "/robots/sim1"
    closed = ann.ask("POST", f"/requests/{number}/close", {"note": "  a\n<i>b</i> "}).json
    assert closed["note"] == "a <i>b</i>"

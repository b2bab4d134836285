"""Robots through the API: as users see them, and as admins change them and their keys."""

from api_visitor import new_public_key
from robot_signer import RobotSigner

MAC = "00:1b:44:11:3a:b7"


def registration(**changes):
    return {"mac": MAC, "public_key": new_public_key(), "hostname": "turtle"} | changes


def test_driver_and_stop_are_told_to_whoever_may_see_the_robot(ann, root, admin_database):
    with admin_database.transaction() as tx:
        for number, robot in enumerate(("sim1", "sim2"), start=1):
            tx.change(
                "INSERT INTO control_leases (robot_id, fence, user_name, since) "
                "SELECT id, %s, 'ben', '2026-01-01 12:03:00.9' FROM robots WHERE name = %s",
                (number, robot),
            )
        tx.change("UPDATE control_leases SET ended_at = CURRENT_TIMESTAMP(6) WHERE fence = 2")
        tx.change(
            "INSERT INTO robot_stops (robot_id, by_name, stopped_at, reason) "
            "SELECT id, 'zoe', '2026-01-01 12:04', 'smoke' FROM robots WHERE name = 'sim1'"
        )
    driver = {"user": "ben", "since": "2026-01-01T12:03:00Z"}
    stopped = {"by": "zoe", "at": "2026-01-01T12:04:00Z"}
    robot = ann.get("/robots/sim1")
    assert (robot["driver"], robot["stopped"]) == (driver, stopped)
    assert ann.get("/robots")["robots"] == [robot]
    seen = root.get("/robots")["robots"]
    assert [item["driver"] for item in seen] == [driver, None]
    assert [item["stopped"] for item in seen] == [stopped, None]


def test_state_may_be_what_it_is(root):
    """A program that says it twice means the same."""
    root.ask("PUT", "/robots/turtle", registration())
    for state in ("disabled", "disabled", "active", "active"):
        answer = root.ask("PATCH", "/robots/turtle", {"state": state})
        assert (answer.status_code, answer.json["state"]) == (200, state)


def test_join_token_enrols_and_is_told_no_more_than_a_user(program, root, site_certificate):
    """Asking again uses nothing up; the token's bearer is no admin."""
    made = root.ask("POST", "/join-tokens", {"name": "one", "uses": 1, "hours": 1}).json
    headers = {"Authorization": f"Bearer {made['token']}"}
    robot = RobotSigner()
    body = registration(public_key=robot.line)
    for shown, refusal in (({}, (401, "login_missing")), (headers, (403, "key_unproven"))):
        answer = program.ask("PUT", "/api/v1/robots/turtle", json=body, headers=shown)
        assert (answer.status_code, answer.json["code"]) == refusal
    body["signature"] = robot.proof(MAC)
    for status in (201, 200):
        answer = program.ask("PUT", "/api/v1/robots/turtle", json=body, headers=headers)
        assert answer.status_code == status, answer.text
        assert answer.json["level"] is None
        assert not {"fingerprint", "address", "join_address", "driver", "stopped"} & set(
            answer.json
        )
    robot, mac = RobotSigner(), "00:1b:44:11:3a:b8"
    other = registration(mac=mac, public_key=robot.line, signature=robot.proof(mac))
    answer = program.ask("PUT", "/api/v1/robots/other", json=other, headers=headers)
    assert (answer.status_code, answer.json["code"]) == (401, "token_used_up")


def test_only_managers_may(ann):
    """A driver is refused, whatever is sent; a robot that cannot be seen is not there."""
    for part in ("page", "buttons"):
        assert ann.refused("PUT", f"/robots/sim1/{part}", {"x": 1}) == (403, "grant_missing")
        assert ann.refused("PUT", f"/robots/sim2/{part}", {}) == (404, "robot_unknown")

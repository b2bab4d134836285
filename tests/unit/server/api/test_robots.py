"""Robots through the API: as users see them, and as admins change them and their keys."""

import pytest
from api_visitor import Program
from robot_signer import RobotSigner

MAC = "00:1b:44:11:3a:b7"


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


@pytest.mark.usefixtures("site_certificate")
def test_join_token_enrols_and_is_told_no_more_than_a_user(program, root):
    """Asking again uses nothing up; the token's bearer is no admin."""
    made = root.ask("POST", "/join-tokens", {"name": "one", "uses": 1, "hours": 1}).json
    bearer = Program(program, {"Authorization": f"Bearer {made['token']}"})
    robot = RobotSigner()
    body = {"mac": MAC, "public_key": robot.line}
    nobody = Program(program, {})
    assert nobody.refused("PUT", "/robots/turtle", body) == (401, "login_missing")
    assert bearer.refused("PUT", "/robots/turtle", body) == (403, "key_unproven")
    body["signature"] = robot.proof(MAC)
    for status in (201, 200):
        answer = bearer.ask("PUT", "/robots/turtle", body)
        assert (answer.status_code, answer.json["level"]) == (status, None)
        hidden = {"fingerprint", "address", "join_address", "driver", "stopped"}
        assert hidden.isdisjoint(answer.json)
    robot, mac = RobotSigner(), "00:1b:44:11:3a:b8"
    other = {"mac": mac, "public_key": robot.line, "signature": robot.proof(mac)}
    assert bearer.refused("PUT", "/robots/other", other) == (401, "token_used_up")

"""Robots through the API: as users see them, and as admins change them and their keys."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest
from api_visitor import Program, new_public_key
from drive_settings import DOCK, LIGHTS, audited, kept
from robot_signer import RobotSigner
from robotether_server.api.operations import plain
from robotether_server.api.robots import shown_robot
from robotether_server.db import Database
from robotether_server.db.robots import Report, RobotRow
from robotether_server.db.seen_robots import FREE, ControlState, SeenRobot
from robotether_server.identity import parse_robots_key
from robotether_server.page_settings import DEFAULTS
from web_visitor import Browser, audit_kinds

MAC = "00:1b:44:11:3a:b7"


def registration(**changes: Any) -> dict[str, Any]:
    return {"mac": MAC, "public_key": new_public_key(), "hostname": "turtle"} | changes


def test_driver_and_stop_are_told_to_whoever_may_see_the_robot(
    ann: Program, root: Program, admin_database: Database
) -> None:
    """In the list and alone, as the relay wrote them."""
    with admin_database.transaction() as tx:
        for number, robot in enumerate(("sim1", "sim2"), start=1):
            tx.change(
                "INSERT INTO control_leases (robot_id, fence, user_name, since) "
                "SELECT id, %s, 'ben', '2026-01-01 12:03:00.9' FROM robots WHERE name = %s",
                (number, robot),
            )
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
    assert [one["driver"] for one in seen] == [driver, driver]
    assert [one["stopped"] for one in seen] == [stopped, None]


@pytest.mark.parametrize("name", ["sim2", "ghost", "SIM1", "s%C3%ADm1", "x" * 100])
def test_robot_that_the_user_may_not_see_is_none(ann: Program, name: str) -> None:
    """It looks like one that does not exist; and a name has one spelling."""
    assert ann.refused("GET", f"/robots/{name}") == (404, "robot_unknown")


def test_robot_is_changed_in_one_step(root: Program, database: Database) -> None:
    """All that is given, the name last."""
    changes = {
        "name": "turtle",
        "mac": "00-1B-44-11-3A-B7",
        "shell": True,
        "settings": {"shell_user": "pi"},
        "state": "disabled",
    }
    answer = root.ask("PATCH", "/robots/sim1", changes)
    assert answer.status_code == 200
    shown = answer.json
    assert (shown["name"], shown["mac"], shown["state"]) == ("turtle", MAC, "disabled")
    assert (shown["shell_port"], shown["settings"]) == (24000, {"shell_user": "pi"})
    assert root.get("/robots/turtle") == shown
    assert {actor for _, actor, _ in audit_kinds(database)} == {"root"}


def test_state_may_be_what_it_is(root: Program) -> None:
    """A program that says it twice means the same."""
    root.ask("PUT", "/robots/turtle", registration())
    for state in ("disabled", "disabled", "active", "active"):
        answer = root.ask("PATCH", "/robots/turtle", {"state": state})
        assert (answer.status_code, answer.json["state"]) == (200, state)


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        ({}, (422, "field_invalid")),
        ({"colour": "red"}, (422, "field_invalid")),
        ({"name": "Sim"}, (422, "record_refused")),
        ({"name": "sim2"}, (409, "record_exists")),
        ({"name": None}, (422, "field_invalid")),
        ({"mac": "rubbish"}, (422, "field_invalid")),
        ({"mac": "ff:ff:ff:ff:ff:ff"}, (422, "field_invalid")),
        ({"mac": "02:00:00:00:51:02"}, (409, "record_exists")),
        ({"state": "pending"}, (422, "field_invalid")),
        ({"state": "active"}, (409, "not_possible")),
        ({"shell": "yes"}, (422, "field_invalid")),
        ({"settings": []}, (422, "field_invalid")),
        ({"settings": {"shell_user": "a b"}}, (422, "field_invalid")),
        ({"settings": {"speed": 1}}, (422, "field_invalid")),
    ],
)
def test_change_is_refused(
    root: Program, changes: dict[str, Any], refusal: tuple[int, str]
) -> None:
    """Each with the code that says why."""
    assert root.refused("PATCH", "/robots/sim1", changes) == refusal


def test_playbook_enrols_a_robot_once(root: Program) -> None:
    """201, then 200 with the same answer; ssh is what the robot pins."""
    body = registration()
    first = root.ask("PUT", "/robots/turtle", body)
    assert first.status_code == 201
    assert (first.json["state"], first.json["level"]) == ("active", "manage")
    assert first.json["fingerprint"] == parse_robots_key(body["public_key"]).fingerprint
    assert first.json["ssh"]["host_keys"] == ["ssh-ed25519 AAAAhost"]
    second = root.ask("PUT", "/robots/turtle", body)
    assert (second.status_code, second.json) == (200, first.json)


def test_join_token_enrols_and_is_told_no_more_than_a_user(
    program: Browser, root: Program, site_certificate: None
) -> None:
    """Asking again uses nothing up; the token's bearer is no admin."""
    made = root.ask("POST", "/join-tokens", {"name": "one", "uses": 1, "hours": 1}).json
    headers = {"Authorization": f"Bearer {made['token']}"}
    robot = RobotSigner()
    body = registration(public_key=robot.line)
    refused = program.ask("PUT", "/api/v1/robots/turtle", json=body, headers=headers)
    assert (refused.status_code, refused.json["code"]) == (403, "key_unproven")
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


@pytest.mark.parametrize(
    ("name", "changes", "refusal"),
    [
        ("turtle", {"mac": "01:00:5e:00:00:01"}, (422, "field_invalid")),
        ("turtle", {"public_key": "ssh-rsa AAAA"}, (422, "field_invalid")),
        ("turtle", {"hostname": 5}, (422, "field_invalid")),
        ("turtle", {"hostname": "a\nb"}, (422, "field_invalid")),
        ("turtle", {"token": "rj_x"}, (422, "field_invalid")),
        ("Turtle", {}, (422, "record_refused")),
        ("sim2", {"mac": "02:00:00:00:51:01"}, (409, "record_exists")),
        ("sim2", {}, (409, "record_exists")),
    ],
)
def test_registration_is_refused(
    root: Program, name: str, changes: dict[str, Any], refusal: tuple[int, str]
) -> None:
    """The sentence says who decides about the registration."""
    assert root.refused("PUT", f"/robots/{name}", registration(**changes)) == refusal


def test_user_cannot_enrol(ann: Program, program: Browser) -> None:
    """An admin's token or a join token does; nothing at all is 401."""
    assert ann.refused("PUT", "/robots/turtle", registration()) == (403, "grant_missing")
    answer = program.ask("PUT", "/api/v1/robots/turtle", json=registration())
    assert (answer.status_code, answer.json["code"]) == (401, "login_missing")


PAGE, BUTTONS = "/robots/sim1/page", "/robots/sim1/buttons"


@pytest.fixture
def _ann_manages(root: Program, ann: Program) -> None:
    assert ann
    policy = {"drive": {"publish": ["/lights"], "call": ["/dock"]}}
    assert root.ask("PATCH", "/robots/sim1", {"settings": {"policy": policy}}).status_code == 200
    assert root.ask("PUT", "/grants/ann/sim1", {"level": "manage"}).status_code < 300


@pytest.mark.usefixtures("_ann_manages")
def test_manager_sets_the_page(ann: Program, database: Database) -> None:
    """In place of the earlier; the answer has the defaults, too, and the rest of the settings stays."""
    answer = ann.ask("PUT", PAGE, {"kind": "holonomic", "hold_after_ms": None})
    given = {"kind": "holonomic", "hold_after_ms": None}
    assert (answer.status_code, answer.json) == (200, DEFAULTS.as_dict() | given)
    assert kept(database, "page") == given
    assert ann.ask("PUT", PAGE, {}).json == DEFAULTS.as_dict()
    assert ann.get("/robots/sim1")["settings"].keys() == {"policy"}
    was = {"was": given, "page": None}
    assert audited(database, "robot_page_set")[0] == ("ann", was)


@pytest.mark.usefixtures("_ann_manages")
def test_manager_sets_the_buttons(ann: Program, database: Database) -> None:
    """All of them in one list."""
    answer = ann.ask("PUT", BUTTONS, {"buttons": [LIGHTS, DOCK]})
    assert (answer.status_code, answer.json) == (200, {"buttons": [LIGHTS, DOCK]})
    assert kept(database, "buttons") == [LIGHTS, DOCK]
    assert ann.ask("PUT", BUTTONS, {"buttons": []}).json == {"buttons": []}
    assert [actor for actor, _ in audited(database, "robot_buttons_set")] == ["ann", "ann"]


@pytest.mark.usefixtures("_ann_manages")
@pytest.mark.parametrize(
    ("path", "body", "sentence"),
    [
        (PAGE, {"kind": "tank"}, "page.kind"),
        (PAGE, {"camera": []}, "'camera'"),
        (BUTTONS, {}, "buttons"),
        (BUTTONS, {"buttons": [{**LIGHTS, "topic": "/arm"}]}, "policy.drive.publish"),
        (BUTTONS, {"buttons": [LIGHTS, {**DOCK, "service": 1}]}, "buttons.2.service"),
    ],
)
def test_what_is_wrong_is_named(ann: Program, path: str, body: object, sentence: str) -> None:
    """By its path, and with what an admin would have to add."""
    answer = ann.ask("PUT", path, body)
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")
    assert sentence in answer.json["detail"]


@pytest.mark.usefixtures("_ann_manages")
@pytest.mark.parametrize("path", [PAGE, BUTTONS])
def test_only_managers_may(root: Program, ann: Program, path: str) -> None:
    """A driver is refused, whatever is sent; a robot that cannot be seen is not there."""
    root.ask("PUT", "/grants/ann/sim1", {"level": "drive"})
    assert ann.refused("PUT", path, {"nonsense": 1}) == (403, "grant_missing")
    assert ann.refused("PUT", path.replace("sim1", "sim2"), {}) == (404, "robot_unknown")


@pytest.mark.usefixtures("_ann_manages")
def test_an_admin_may_not_take_a_buttons_right_away_unseen(root: Program, ann: Program) -> None:
    """The refusal names the button, which goes first."""
    ann.ask("PUT", BUTTONS, {"buttons": [DOCK]})
    answer = root.ask("PATCH", "/robots/sim1", {"settings": {"buttons": [DOCK]}})
    assert answer.status_code == 422
    assert "cannot use button 'Dock'" in answer.json["detail"]
    assert root.ask("PATCH", "/robots/sim1", {"settings": {}}).status_code == 200


@pytest.fixture
def fingerprint(program: Browser) -> str:
    """The key that waits at sim1, which was announced."""
    return join(program, "02:00:00:00:51:01")


def join(program: Browser, mac: str) -> str:
    """The fingerprint of a key that joined."""
    robot = RobotSigner()
    assert program.ask("POST", "/api/v1/join", json=robot.join(mac)).status_code == 202
    return robot.key.fingerprint


@pytest.mark.parametrize("action", ["approve", "reject"])
def test_no_other_key_than_the_named_one(root: Program, fingerprint: str, action: str) -> None:
    """Whatever came since the admin compared them."""
    path = f"/robots/sim1/{action}"
    assert root.refused("POST", path, {"fingerprint": "SHA256:other"}) == (409, "not_possible")
    assert root.refused("POST", path, {}) == (422, "field_invalid")
    assert root.refused("POST", path) == (415, "unsupported_media_type")
    ghost = f"/robots/ghost/{action}"
    assert root.refused("POST", ghost, {"fingerprint": fingerprint}) == (404, "record_missing")


TIMESTAMP = dt.datetime(2026, 1, 1, 12, 3, 0, 900000, dt.UTC)
ROBOT = RobotRow(
    id=7,
    mac="00:1b:44:11:3a:b7",
    name="turtle",
    state="active",
    ros_port=20000,
    video_port=20001,
    fingerprint="SHA256:abc",
    settings={"shell_user": "pi"},
    site="lab",
    report=Report("turtle.local", "0.1.0", "192.0.2.1"),
    joined_at=TIMESTAMP,
)
SEEN = SeenRobot(ROBOT, True, TIMESTAMP, "drive", "198.51.100.9", "0.2.0")


def shown(control: ControlState | None, *, for_admin: bool) -> Any:
    """The robot as JSON has it."""
    return plain(shown_robot(SEEN, control, for_admin=for_admin))


def test_admins_see_more() -> None:
    """What the join told, and what the newest session does."""
    users = shown(FREE, for_admin=False)
    seen = shown(FREE, for_admin=True)
    assert {name: value for name, value in seen.items() if name not in users} == {
        "fingerprint": "SHA256:abc",
        "hostname": "turtle.local",
        "agent_version": "0.2.0",
        "join_address": "192.0.2.1",
        "joined_at": "2026-01-01T12:03:00Z",
        "address": "198.51.100.9",
        "rotate_key": False,
    }


@pytest.mark.parametrize("query", ["limit=0", "limit=501", "most=1"])
def test_wrong_query_for_sessions_is_refused(root: Program, query: str) -> None:
    """The refusal names the wrong parameter."""
    assert root.refused("GET", f"/robots/sim1/sessions?{query}") == (422, "field_invalid")

"""The REST API, answer by answer as docs/protocols.md has it."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from robotether_server.settings import WebSettings
from robotether_server.store import Database, digests, robots, users
from robotether_server.tickets import TicketSigner
from robotether_server.web import create_app
from web_visitor import Browser, audit_kinds, bearer

TICKET_KEY = "t" * 32  # that of the fixture web_settings
MAC = "02:00:00:00:61:01"


@pytest.fixture
def key(tmp_path: Path) -> str:
    """A robot's public key."""
    file = tmp_path / "robot_key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", file], check=True)
    return file.with_suffix(".pub").read_text()


def join_body(key: str, **changes: object) -> dict[str, object]:
    body = {"mac": MAC, "public_key": key, "hostname": "turtle", "agent_version": "0.1.0"}
    return body | changes


def test_robots_are_listed_with_what_the_user_may(program: Browser, database: Database) -> None:
    """A user sees granted robots; an admin sees all, to manage."""
    answer = program.ask("GET", "/api/v1/robots", headers=bearer(database, "ann"))
    assert answer.json == {
        "robots": [
            {
                "name": "sim1",
                "mac": "02:00:00:00:51:01",
                "state": "pending",
                "online": False,
                "since": None,
                "level": "drive",
                "ros_port": 20000,
                "video_port": 20001,
            }
        ]
    }
    seen = program.ask("GET", "/api/v1/robots", headers=bearer(database, "root")).json["robots"]
    assert [(robot["name"], robot["level"]) for robot in seen] == [
        ("sim1", "manage"),
        ("sim2", "manage"),
    ]


def test_online_robot_has_since(
    program: Browser, database: Database, admin_database: Database
) -> None:
    """The moment is RFC 3339 in UTC, to the second."""
    with admin_database.transaction() as tx:
        tx.insert(
            "INSERT INTO robot_sessions (robot_id, address, started_at) "
            "SELECT id, '', '2026-01-01 12:03:00.9' FROM robots WHERE name = 'sim1'"
        )
    [robot] = program.ask("GET", "/api/v1/robots", headers=bearer(database, "ann")).json["robots"]
    assert (robot["online"], robot["since"]) == (True, "2026-01-01T12:03:00Z")


@pytest.mark.parametrize(
    ("user", "mode"), [("ann", "drive"), ("ann", "observe"), ("olga", "observe"), ("root", "drive")]
)
def test_ticket_is_given_within_the_grant(
    program: Browser, database: Database, user: str, mode: str
) -> None:
    """The relay can verify it, and it names user, robot and mode."""
    body = {"robot": "sim1", "mode": mode}
    token = bearer(database, user)
    answer = program.ask("POST", "/api/v1/tickets", json=body, headers=token)
    assert answer.status_code == 201
    text = answer.json["ticket"]
    assert answer.json == {
        "ticket": text,
        "robot": "sim1",
        "mode": mode,
        "expires_in_s": 30,
        "ros_url": f"/robots/sim1/ros?ticket={text}",
    }
    ticket, _ = TicketSigner(TICKET_KEY, 30).verify(text)
    with database.transaction() as tx:
        robot, owner = robots.get(tx, "sim1"), users.get(tx, user)
    assert (ticket.user_id, ticket.user) == (owner.id, user)
    assert (ticket.robot_id, ticket.robot, ticket.mode) == (robot.id, "sim1", mode)
    sha256 = digests.digest(token["Authorization"].removeprefix("Bearer ")).hex()
    assert (ticket.credential, ticket.credential_sha256) == ("token", sha256)


@pytest.mark.parametrize(
    ("user", "body", "refusal"),
    [
        ("olga", {"robot": "sim1", "mode": "drive"}, (403, "grant_missing")),
        ("ann", {"robot": "sim2", "mode": "observe"}, (404, "robot_unknown")),
        ("ann", {"robot": "ghost", "mode": "observe"}, (404, "robot_unknown")),
        ("ann", {"robot": "sim1", "mode": "fly"}, (422, "field_invalid")),
        ("ann", {"robot": "sim1"}, (422, "field_invalid")),
        ("ann", {"robot": 7, "mode": "drive"}, (422, "field_invalid")),
        ("ann", ["sim1"], (422, "field_invalid")),
    ],
)
def test_ticket_is_refused(
    program: Browser, database: Database, user: str, body: object, refusal: tuple[int, str]
) -> None:
    """A robot that the user may not see looks like one that does not exist."""
    answer = program.ask("POST", "/api/v1/tickets", json=body, headers=bearer(database, user))
    assert (answer.status_code, answer.json["code"]) == refusal
    assert answer.content_type == "application/problem+json"


def test_unknown_robot_waits_until_an_admin_approves(
    program: Browser, database: Database, key: str
) -> None:
    """The answer says how; asking again changes nothing, and leaves one audit event in all."""
    for _ in range(2):
        answer = program.ask("POST", "/api/v1/join", json=join_body(key))
        assert answer.status_code == 202
        assert answer.json["code"] == "approval_pending"
        assert answer.json["robot"] == "robot-006101"
        assert "robotether robot approve robot-006101" in answer.json["detail"]
    assert audit_kinds(database) == [("robot_pending", "robot", "198.51.100.7")]
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "robot-006101").id, "active")
    answer = program.ask("POST", "/api/v1/join", json=join_body(key))
    assert answer.status_code == 200
    assert answer.json == {
        "state": "active",
        "robot": "robot-006101",
        "ssh": {
            "user": "tunnel",
            "host": None,
            "ports": [2222, 443],
            "host_keys": ["ssh-ed25519 AAAAhost"],
        },
    }


def test_join_with_an_admins_token_is_active_at_once(
    program: Browser, database: Database, key: str
) -> None:
    """Any other token does not do."""
    token = bearer(database, "root")["Authorization"].split()[1]
    answer = program.ask("POST", "/api/v1/join", json=join_body(key, token=token))
    assert (answer.status_code, answer.json["state"]) == (200, "active")
    users_token = bearer(database, "ann")["Authorization"].split()[1]
    for wrong, status in (("rt_nobodys", 401), (users_token, 403)):
        answer = program.ask("POST", "/api/v1/join", json=join_body(key, token=wrong))
        assert answer.status_code == status


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"mac": "rubbish"}, "mac"),
        ({"mac": None}, "mac"),
        ({"public_key": "ssh-rsa AAAA"}, "public_key"),
        ({"public_key": 'command="sh" ssh-ed25519 AAAA'}, "public_key"),
        ({"hostname": ""}, "hostname"),
        ({"hostname": "x" * 254}, "hostname"),
        ({"hostname": "a\x1b[2J"}, "hostname"),
        ({"agent_version": 1}, "agent_version"),
        ({"token": 5}, "token"),
    ],
)
def test_join_names_the_field_that_is_wrong(
    program: Browser, key: str, changes: dict[str, object], named: str
) -> None:
    """422, and a sentence with the field's name."""
    answer = program.ask("POST", "/api/v1/join", json=join_body(key, **changes))
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")
    assert named in answer.json["detail"]


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"\xff\xfe", b"null"])
def test_join_without_an_object_is_refused(program: Browser, body: bytes) -> None:
    """Broken JSON is a wrong body, not a failure of the server."""
    answer = program.ask("POST", "/api/v1/join", data=body)
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")


def test_api_describes_itself(program: Browser) -> None:
    """Every path under /api/v1 that Flask has stands in the document, with its methods."""
    document = program.ask("GET", "/api/v1/openapi.json").json
    assert document["openapi"].startswith("3.1")
    served = {
        (rule.rule, method.lower())
        for rule in program.client.application.url_map.iter_rules()
        if rule.rule.startswith("/api/v1/")
        for method in rule.methods - {"HEAD", "OPTIONS"}
    }
    described = {(path, method) for path, item in document["paths"].items() for method in item}
    assert served <= described
    assert json.dumps(document)


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/api/v1/nothing", 404, "not_found"),
        ("GET", "/api/v1/join", 405, "method_not_allowed"),
    ],
)
def test_wrong_paths_and_methods_are_problems_too(
    program: Browser, method: str, path: str, status: int, code: str
) -> None:
    """Programs get JSON whatever happens."""
    answer = program.ask(method, path)
    assert (answer.status_code, answer.json["code"]) == (status, code)
    assert answer.content_type == "application/problem+json"


def test_database_that_is_away_is_said_so(web_settings: WebSettings) -> None:
    """503 with a code; the health check still answers."""
    away = replace(web_settings, database=replace(web_settings.database, port=1))
    program = Browser(create_app(away).test_client())
    answer = program.ask("GET", "/api/v1/robots", headers={"Authorization": "Bearer rt_x"})
    assert (answer.status_code, answer.json["code"]) == (503, "store_unavailable")
    assert program.ask("GET", "/healthz").status_code == 200

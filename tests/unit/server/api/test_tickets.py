"""Tickets: given within the grant, and nothing told beyond it."""

from __future__ import annotations

import datetime as dt

import pytest
from relay_server import cell_settings
from robotether_server.db import Database, cells, credentials, fleet, robots, users
from robotether_server.db.fleet import SessionEntry
from robotether_server.tickets import TicketSigner
from web_visitor import Browser, bearer

TICKET_KEY = "t" * 32  # that of the fixture web_settings


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
    sha256 = credentials.digest(token["Authorization"].removeprefix("Bearer ")).hex()
    assert (ticket.credential, ticket.credential_sha256) == ("token", sha256)


def test_ticket_names_the_cell_of_the_robot(
    program: Browser, database: Database, relay_database: Database
) -> None:
    """While the robot is online there, and the cell is in service."""
    body, headers = {"robot": "sim1", "mode": "observe"}, bearer(database, "ann")

    def ask() -> object:
        return program.ask("POST", "/api/v1/tickets", json=body, headers=headers).json.get("cell")

    assert ask() is None
    with database.transaction() as tx:
        sim1 = robots.get(tx, "sim1")
    with relay_database.transaction() as tx:
        now = dt.datetime.now(dt.UTC)
        cells.write_heartbeat(tx, cell_settings("b", "b.example"), robots=1, started_at=now)
        fleet.write(tx, [SessionEntry(sim1.id, now, "192.0.2.1")], "b")
    assert ask() == {"host": "b.example", "port": 443}
    with database.transaction() as tx:
        tx.change("UPDATE cells SET draining = TRUE")
    assert ask() is None


@pytest.mark.parametrize(
    ("user", "body", "refusal"),
    [
        ("olga", {"robot": "sim1", "mode": "drive"}, (403, "grant_missing")),
        ("ann", {"robot": "sim2", "mode": "observe"}, (404, "robot_unknown")),
        ("ann", {"robot": "ghost", "mode": "observe"}, (404, "robot_unknown")),
        ("ann", {"robot": "sim1", "mode": "fly"}, (422, "field_invalid")),
        ("ann", {"robot": "sim1"}, (422, "field_invalid")),
        ("ann", {"robot": 7, "mode": "drive"}, (422, "field_invalid")),
        ("ann", {"robot": "sim1", "mode": "drive", "days": 1}, (422, "field_invalid")),
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

"""Tickets: given within the grant, and nothing told beyond it."""

import datetime as dt
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
from granted import take
from relay_server import cell_settings
from robotether_server.db import Database, cells, credentials, fleet, robots, users
from robotether_server.db import database as database_module
from robotether_server.db.fleet import SessionEntry
from robotether_server.settings.server import DatabaseSettings
from robotether_server.tickets import TicketSigner
from web_visitor import bearer

TICKET_KEY = "t" * 32  # that of the fixture web_settings
UNAVAILABLE = (503, "store_unavailable")


@pytest.mark.parametrize(
    ("user", "mode"), [("ann", "drive"), ("ann", "observe"), ("olga", "observe"), ("root", "drive")]
)
def test_ticket_is_given_within_the_grant(program, database, user, mode):
    body = {"robot": "sim1", "mode": mode}
    token = bearer(database, user)
    answer = program.ask("POST", "/api/v1/tickets", json=body, headers=token)
    text = answer.json["ticket"]
    assert answer.json["ros_url"] == f"/robots/sim1/ros?ticket={text}"
    ticket, _ = TicketSigner(TICKET_KEY, 30).verify(text)
    with database.transaction() as tx:
        robot, owner = robots.get(tx, "sim1"), users.get(tx, user)
    assert (ticket.user_id, ticket.user) == (owner.id, user)
    assert (ticket.robot_id, ticket.robot, ticket.mode) == (robot.id, "sim1", mode)
    sha256 = credentials.digest(token["Authorization"].removeprefix("Bearer ")).hex()
    assert (ticket.credential, ticket.credential_sha256) == ("token", sha256)


def test_no_ticket_is_beyond_the_grant_or_for_another_robot_that_got_the_name(program, database):
    token = bearer(database, "ann")
    assert answer_of(program, bearer(database, "olga"), mode="drive") == (403, "grant_missing")
    with database.transaction() as tx:
        mac = robots.get(tx, "sim1").mac
    assert answer_of(program, token, mode="observe", mac=mac.upper()) == (201, "")
    with database.transaction() as tx:
        tx.change("UPDATE robots SET mac = '00:1b:44:11:3a:b7' WHERE name = 'sim1'")
    assert answer_of(program, token, mode="observe", mac=mac) == (404, "robot_unknown")


def test_ticket_names_the_cell_of_the_robot(program, database, relay_database):
    body, headers = {"robot": "sim1", "mode": "observe"}, bearer(database, "ann")

    def ask():
        return program.ask("POST", "/api/v1/tickets", json=body, headers=headers).json.get("cell")

    assert ask() is None
    with database.transaction() as tx:
        sim1 = robots.get(tx, "sim1")
    with relay_database.transaction() as tx:
        now = dt.datetime.now(dt.UTC)
        cells.write_heartbeat(tx, cell_settings("b", "b.example"), cells.CellCounts(), now)
        fleet.write(tx, [SessionEntry(sim1.id, now, "192.0.2.1")], "b")
    assert ask() == {"host": "b.example", "port": 443}
    with database.transaction() as tx:
        tx.change("UPDATE cells SET draining = TRUE")
    assert ask() is None


@pytest.fixture
def away(app):
    """Have the database away for a while; web goes on with what it remembers."""

    @contextmanager
    def gone():
        with_it = app.extensions["robotether"]
        nobody = Database(DatabaseSettings("127.0.0.1", 1, "robotether", "web", "x"))
        app.extensions["robotether"] = replace(with_it, database=nobody)
        try:
            yield
        finally:
            app.extensions["robotether"] = with_it

    return gone


def answer_of(visitor, headers, **body):
    answer = visitor.ask("POST", "/api/v1/tickets", json={"robot": "sim1"} | body, headers=headers)
    return answer.status_code, answer.json.get("code", "")


def test_without_a_database_a_user_of_lately_gets_a_ticket(program, database, away):
    ann = bearer(database, "ann")
    assert program.ask("GET", "/api/v1/robots", headers=ann).status_code == 200
    with database.transaction() as tx:
        owner = users.get(tx, "ann")
    with away():
        body = {"robot": "sim2", "mode": "drive", "mac": "00-1B-44-11-3A-B7"}
        answer = program.ask("POST", "/api/v1/tickets", json=body, headers=ann)
        assert answer.status_code == 201
        ticket, _ = TicketSigner(TICKET_KEY, 30).verify(answer.json["ticket"])
        assert (ticket.user_id, ticket.user) == (owner.id, "ann")
        assert (ticket.robot_id, ticket.robot, ticket.mode) == (None, "sim2", "drive")
        assert (ticket.remembered, ticket.mac) == (True, "00:1b:44:11:3a:b7")
        sha256 = credentials.digest(ann["Authorization"].removeprefix("Bearer ")).hex()
        assert (ticket.credential, ticket.credential_sha256) == ("token", sha256)
        answer = program.ask("GET", "/api/v1/robots", headers=ann)
        assert (answer.status_code, answer.json["code"]) == UNAVAILABLE
        other = {"Authorization": "Bearer rt_other"}
        assert answer_of(program, other, mode="drive") == UNAVAILABLE
        assert answer_of(program, {"Authorization": "Basic x"}, mode="drive")[0] == 401
        assert answer_of(program, ann, mode="fly") == (422, "field_invalid")


def test_a_database_that_hangs_keeps_nobody_waiting_for_long(
    program, database, mariadb, monkeypatch
):
    """An operation that can do without it gives up soon."""
    monkeypatch.setattr(database_module, "BRIEF_TIMEOUT_S", 1)
    ann = bearer(database, "ann")
    assert answer_of(program, ann, mode="observe") == (201, "")
    mariadb.container.pause()
    try:
        began_s = time.monotonic()
        assert answer_of(program, ann, mode="drive") == (201, "")
        assert time.monotonic() - began_s < database_module.ANSWER_TIMEOUT_S / 2
    finally:
        mariadb.container.unpause()


def test_what_the_database_denies_is_remembered_no_more(program, database, away):
    ann, olga = (bearer(database, name) for name in ("ann", "olga"))
    for token in (ann, olga):
        assert answer_of(program, token, mode="observe") == (201, "")
    with database.transaction() as tx:
        (mine,) = credentials.list_tokens_of(tx, users.get(tx, "ann"))
        credentials.delete_token(tx, mine.id)
        take(tx, users.get(tx, "olga").id, robots.get(tx, "sim1").id)
    assert answer_of(program, ann, mode="observe") == (401, "token_invalid")
    assert answer_of(program, olga, mode="observe") == (404, "robot_unknown")
    with away():
        assert answer_of(program, ann, mode="observe") == UNAVAILABLE
        assert answer_of(program, olga, mode="observe") == (201, "")


def test_without_a_database_a_login_still_needs_the_pages_word(browser, database, away):
    """Another site could make the browser send the cookie."""
    browser.log_in("ann")
    page = {"X-CSRFToken": browser.csrf_of("/profile")}
    assert answer_of(browser, page, mode="observe") == (201, "")
    with away():
        assert answer_of(browser, page, mode="drive") == (201, "")
        assert answer_of(browser, {}, mode="drive") == (403, "csrf_refused")

"""Deeds: asked about first, done by a POST, told afterwards; a failure comes back with the form."""

from __future__ import annotations

from admin_visitor import send
from robotether_server.db import Database, robots
from web_visitor import Browser, audit_kinds


def test_asking_changes_nothing(browser: Browser, database: Database) -> None:
    """It names what is affected, and says how to undo it."""
    browser.log_in("root")
    page = browser.ask("GET", "/admin/robots/sim1/disable").text
    assert "Disable robot sim1?" in page
    assert "Undo:" in page
    with database.transaction() as tx:
        assert robots.get(tx, "sim1").state == "pending"


def test_a_deed_is_done_and_told_once(browser: Browser, database: Database) -> None:
    """The next page has the message, the one after has not."""
    browser.log_in("root")
    answer = send(browser, "/admin/robots/sim1/disable")
    assert (answer.status_code, answer.location) == (303, "/admin/robots/sim1")
    assert "Robot sim1 is disabled." in browser.ask("GET", "/admin/robots/sim1").text
    assert "Robot sim1 is disabled." not in browser.ask("GET", "/admin/robots/sim1").text
    assert ("robot_disabled", "root", "198.51.100.7") in audit_kinds(database)


def test_a_deed_that_fails_comes_back_as_it_was_filled_in(browser: Browser) -> None:
    """With the sentence, and the status of the problem."""
    browser.log_in("root")
    answer = send(browser, "/admin/robots/sim1/rename", new_name="sim2")
    assert answer.status_code == 409
    assert 'role="alert"' in answer.text
    assert 'value="sim2"' in answer.text


def test_a_deed_that_fails_changes_nothing(browser: Browser, database: Database) -> None:
    """Not even in part."""
    browser.log_in("root")
    before = audit_kinds(database)
    assert send(browser, "/admin/robots/sim1/mac", mac="rubbish").status_code == 422
    assert audit_kinds(database) == before

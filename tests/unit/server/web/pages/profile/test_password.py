"""One's own password and logins."""

from __future__ import annotations

import pytest
from admin_visitor import send
from flask import Flask
from web_visitor import PASSWORD, Browser

NEW = "an even longer password"


@pytest.fixture
def ann(app: Flask) -> Browser:
    """A user who is logged in."""
    browser = Browser(app.test_client())
    browser.log_in("ann")
    return browser


def test_password_is_changed_and_this_browser_stays(app: Flask, ann: Browser) -> None:
    """Every other one has to log in again, with the new one."""
    other = Browser(app.test_client())
    other.log_in("ann")
    answer = send(ann, "/profile/password", present=PASSWORD, new=NEW, again=NEW)
    assert (answer.status_code, answer.location) == (303, "/profile")
    assert ann.ask("GET", "/profile").status_code == 200
    assert other.ask("GET", "/profile").status_code == 302
    assert other.log_in("ann", PASSWORD).status_code == 401
    assert other.log_in("ann", NEW).status_code == 303


@pytest.mark.parametrize(
    ("form", "status", "sentence"),
    [
        ({"present": "wrong", "new": NEW, "again": NEW}, 401, "present password is not right"),
        ({"present": PASSWORD, "new": NEW, "again": "other"}, 422, "not the same both times"),
        ({"present": PASSWORD, "new": "short", "again": "short"}, 422, "it has 5 characters"),
    ],
)
def test_what_is_wrong_is_said_and_changes_nothing(
    ann: Browser, form: dict[str, str], status: int, sentence: str
) -> None:
    """No password comes back in the form."""
    answer = send(ann, "/profile/password", **form)
    assert (answer.status_code, sentence in answer.text) == (status, True)
    assert PASSWORD not in answer.text
    assert NEW not in answer.text
    assert ann.log_in("ann").status_code == 303


def test_a_browser_that_was_left_open_is_no_way_to_guess(ann: Browser) -> None:
    """The sixth try waits, as it does at the log-in."""
    for _ in range(5):
        assert send(ann, "/profile/password", present="x", new=NEW, again=NEW).status_code == 401
    answer = send(ann, "/profile/password", present=PASSWORD, new=NEW, again=NEW)
    assert (answer.status_code, "too many tries" in answer.text) == (429, True)


def test_log_out_everywhere_ends_this_login_too(ann: Browser) -> None:
    """And the log-in page says that it is done."""
    assert "this one too" in ann.ask("GET", "/profile/log-out").text
    assert send(ann, "/profile/log-out").location == "/login"
    assert "You are logged out everywhere." in ann.ask("GET", "/login").text

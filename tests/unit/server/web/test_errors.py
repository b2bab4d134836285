"""Failures: JSON under /api, a page elsewhere, and never a traceback for the visitor."""

import logging

import pytest
from robotether_server.api import auth


def test_the_menu_stays_for_who_is_logged_in(browser, ann, admin):
    assert "menu-profile" not in browser.ask("GET", "/nothing").text
    assert "menu-profile" in ann.ask("GET", "/nothing").text
    assert "menu-admin" in admin.ask("GET", "/nothing").text


def test_a_file_that_is_not_there_is_no_page(browser):
    """What nginx compresses must hold no secret of the visitor's, as each page's form token is."""
    answer = browser.ask("GET", "/static/nothing.js")
    assert (answer.status_code, answer.mimetype) == (404, "application/problem+json")
    assert "csrf" not in answer.text


@pytest.mark.parametrize(
    ("path", "mimetype"),
    [
        ("/api/v1/me", "application/problem+json"),
        ("/", "text/html"),
        ("/robots/a%0AERROR%20b", "text/html"),
    ],
)
def test_mistake_of_ours_is_logged_and_not_shown(browser, monkeypatch, caplog, path, mimetype):
    def fail(*_, **__):
        raise ZeroDivisionError("the inner reason")

    monkeypatch.setattr(auth, "page_user", fail)
    with caplog.at_level(logging.ERROR):
        answer = browser.ask("GET", path)
    assert (answer.status_code, answer.mimetype) == (500, mimetype)
    assert "inner reason" not in answer.text
    assert "inner reason" in caplog.text
    assert "Traceback" in caplog.text
    assert "\nERROR b" not in caplog.text

"""Failures: JSON under /api, a page elsewhere, and never a traceback for the visitor."""

import html
import logging
import re

import pytest
from robotether_server.api import auth
from robotether_server.problems import StoreUnavailableError
from web_visitor import PASSWORD


def test_a_file_that_is_not_there_is_no_page(browser):
    """What nginx compresses must hold no secret of the visitor's, as each page's form token is."""
    answer = browser.ask("GET", "/static/nothing.js")
    assert (answer.status_code, answer.mimetype) == (404, "application/problem+json")
    assert "csrf" not in answer.text


def test_a_program_learns_what_the_api_would_take(browser):
    for method, path, status, why in (
        ("GET", "/api/v1/robot", 404, "openapi.json lists all"),
        ("POST", "/api/v1/me", 405, "cannot use POST: send GET"),
    ):
        answer = browser.ask(method, path)
        assert (answer.status_code, why in answer.json["detail"]) == (status, True)


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


def hidden_fields(page):
    fields = re.findall(r'<input type="hidden" name="([\w.]+)" value="([^"]*)">', page)
    return {name: html.unescape(value) for name, value in fields}


def test_form_outlives_the_end_of_a_login_without_its_passwords(admin):
    form = {"csrf_token": admin.csrf(), "name": "ben", "role": "user", "password": "typed secret"}
    admin.client.delete_cookie(auth.COOKIE, domain="robots.example")
    ended = admin.ask("POST", "/admin/users", data=form)
    assert ended.status_code == 401
    assert "typed secret" not in ended.text
    login = hidden_fields(ended.text) | {"name": "root", "password": "wrong"}
    login = hidden_fields(admin.ask("POST", "/login", data=login).text) | {"name": "root"}
    again = admin.ask("POST", "/login", data=login | {"password": PASSWORD})
    assert 'action="/admin/users"' in again.text
    sent = hidden_fields(again.text) | {"password": "a long enough password"}
    assert admin.ask("POST", "/admin/users", data=sent).status_code == 303


def test_form_outlives_a_missing_database_without_its_passwords(admin, monkeypatch):
    def fail(*_, **__):
        raise StoreUnavailableError("cannot reach the database: it does not answer")

    form = {"csrf_token": admin.csrf(), "name": '"ben"', "role": "user", "password": "typed secret"}
    with monkeypatch.context() as away:
        away.setattr(auth, "page_user", fail)
        answer = admin.ask("POST", "/admin/users", data=form)
        other_site = admin.ask("POST", "/admin/users", data=form | {"csrf_token": "guessed"})
    assert answer.status_code == 503
    assert "typed secret" not in answer.text
    assert 'name="password" type="password"' in answer.text
    assert "ben" not in other_site.text
    kept = re.findall(r'<input type="hidden" name="(\w+)" value="([^"]*)">', answer.text)
    assert [name for name, _ in kept] == ["csrf_token", "name", "role"]
    sent = {name: html.unescape(value) for name, value in kept}
    assert sent["name"] == '"ben"'
    again = sent | {"name": "ben", "password": "a long enough password"}
    assert admin.ask("POST", "/admin/users", data=again).status_code == 303

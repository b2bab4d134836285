"""Users: listed, added, shown."""

from __future__ import annotations

import re

import pytest
from admin_visitor import send
from flask import Flask
from robotether_server.db import Database, users
from web_visitor import Browser, audit_kinds


def test_list_shows_every_user(admin: Browser) -> None:
    """With how many robots each sees."""
    page = admin.ask("GET", "/admin/users").text
    for name in ("ann", "olga", "root"):
        assert f'data-testid="row-{name}"' in page


def test_a_password_that_was_made_is_shown_once_and_works(app: Flask, admin: Browser) -> None:
    """In the answer to the form, and neither in an address nor in a cookie."""
    answer = send(admin, "/admin/users", name="zoe", role="user", password="")
    assert answer.status_code == 200
    shown = re.search(r'data-testid="secret">([^<]+)<', answer.text)
    assert shown is not None
    assert shown[1] not in str(answer.headers)
    assert answer.headers["Cache-Control"] == "no-store"
    assert shown[1] not in admin.ask("GET", "/admin/users/zoe").text
    zoe = Browser(app.test_client())
    assert zoe.log_in("zoe", shown[1]).status_code == 303


def test_a_password_that_was_typed_is_not_shown(admin: Browser, database: Database) -> None:
    """The user's page follows."""
    answer = send(admin, "/admin/users", name="zoe", role="admin", password="typed by an admin")
    assert (answer.status_code, answer.location) == (303, "/admin/users/zoe")
    with database.transaction() as tx:
        assert users.get(tx, "zoe").role == "admin"
    assert ("user_added", "root", "198.51.100.7") in audit_kinds(database)


@pytest.mark.parametrize(
    ("form", "sentence"),
    [
        ({"name": "ann", "role": "user"}, "the name is taken"),
        ({"name": "zoe", "role": "king"}, "cannot use Role"),
        ({"name": "Zoe!", "role": "user"}, "cannot save the record"),
        ({"name": "zoe", "role": "user", "password": "short"}, "it has 5 characters"),
    ],
)
def test_a_wrong_form_comes_back(admin: Browser, form: dict[str, str], sentence: str) -> None:
    """Filled in, but for the password."""
    answer = send(admin, "/admin/users", **form)
    assert (answer.status_code >= 400, sentence in answer.text) == (True, True)
    assert f'value="{form["name"]}"' in answer.text
    assert "short" not in answer.text


def test_page_of_a_user_shows_the_grants(admin: Browser) -> None:
    """Each with a form to change it."""
    page = admin.ask("GET", "/admin/users/ann").text
    assert 'data-testid="grant-sim1"' in page


def test_unknown_user_is_a_page(admin: Browser) -> None:
    """404."""
    answer = admin.ask("GET", "/admin/users/ghost")
    assert (answer.status_code, "cannot find user ghost" in answer.text) == (404, True)

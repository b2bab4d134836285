"""What an admin does with a user."""

from __future__ import annotations

import re

import pytest
from admin_visitor import send
from flask import Flask
from robotether_server.db import Database, users
from web_visitor import PASSWORD, Browser, audit_kinds


@pytest.fixture
def ann(app: Flask) -> Browser:
    """A user who is logged in."""
    browser = Browser(app.test_client())
    browser.log_in("ann")
    return browser


def is_in(visitor: Browser) -> bool:
    """Whether the login holds."""
    return visitor.ask("GET", "/").status_code == 200


def test_role_is_changed(admin: Browser, database: Database) -> None:
    """And is in force at once."""
    assert send(admin, "/admin/users/ann/role", role="admin").status_code == 303
    with database.transaction() as tx:
        assert users.get(tx, "ann").is_admin


@pytest.mark.parametrize(
    ("action", "kind"), [("disable", "user_disabled"), ("log-out", "logins_ended")]
)
def test_a_user_is_thrown_out(
    admin: Browser, ann: Browser, database: Database, action: str, kind: str
) -> None:
    """With the next request."""
    assert is_in(ann)
    assert send(admin, f"/admin/users/ann/{action}").status_code == 303
    assert not is_in(ann)
    assert audit_kinds(database)[-1] == (kind, "root", "198.51.100.7")


def test_a_disabled_user_is_let_in_again(admin: Browser, ann: Browser) -> None:
    """With the password of before."""
    send(admin, "/admin/users/ann/disable")
    send(admin, "/admin/users/ann/enable")
    assert ann.log_in("ann").status_code == 303


def test_a_new_password_is_made_and_shown(admin: Browser, ann: Browser) -> None:
    """The old one holds no more, nor do logins made with it."""
    answer = send(admin, "/admin/users/ann/password", password="")
    shown = re.search(r'data-testid="secret">([^<]+)<', answer.text)
    assert shown is not None
    assert not is_in(ann)
    assert ann.log_in("ann", PASSWORD).status_code == 401
    assert ann.log_in("ann", shown[1]).status_code == 303


def test_a_typed_password_is_set(admin: Browser, ann: Browser) -> None:
    """And not shown."""
    answer = send(admin, "/admin/users/ann/password", password="chosen by an admin")
    assert (answer.status_code, answer.location) == (303, "/admin/users/ann")
    assert ann.log_in("ann", "chosen by an admin").status_code == 303


def test_a_removed_user_is_gone(admin: Browser, ann: Browser) -> None:
    """The page says before that nobody can bring the user back."""
    assert "cannot be brought back" in admin.ask("GET", "/admin/users/ann/remove").text
    assert send(admin, "/admin/users/ann/remove").location == "/admin/users"
    assert not is_in(ann)


@pytest.mark.parametrize("action", ["role", "disable", "remove"])
def test_what_an_admin_leaves_behind_is_said(admin: Browser, action: str) -> None:
    """Tokens that this admin made for robots and others do not end; a user has made none."""
    said = "Join tokens that root made"
    assert said in admin.ask("GET", f"/admin/users/root/{action}").text
    assert "Join tokens that" not in admin.ask("GET", f"/admin/users/ann/{action}").text


@pytest.mark.parametrize(
    ("action", "form"), [("disable", {}), ("remove", {}), ("role", {"role": "user"})]
)
def test_the_last_admin_stays(admin: Browser, action: str, form: dict[str, str]) -> None:
    """Or nobody could come back to these pages."""
    answer = send(admin, f"/admin/users/root/{action}", **form)
    assert (answer.status_code, "nobody else is an admin" in answer.text) == (409, True)


@pytest.mark.parametrize("action", ["role", "disable", "enable", "password", "log-out", "remove"])
def test_no_deed_on_a_user_who_is_not_there(admin: Browser, action: str) -> None:
    """404, asked or done."""
    assert admin.ask("GET", f"/admin/users/ghost/{action}").status_code == 404
    assert send(admin, f"/admin/users/ghost/{action}").status_code == 404

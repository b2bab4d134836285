"""The API tokens of all users."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
import tls_front
from admin_visitor import send
from flask import Flask
from robotether_server.db import Database, join_tokens
from robotether_server.install_line import SiteCertificates
from robotether_server.settings import SiteAddressSettings
from web_visitor import Browser, audit_kinds, bearer

FORM = {"name": "hall", "uses": "3", "hours": "24"}


def test_an_admin_deletes_a_users_token(
    admin: Browser, program: Browser, database: Database
) -> None:
    """After a question that names both; the program is refused from then on."""
    header = bearer(database, "ann")
    page = admin.ask("GET", "/admin/tokens").text
    path = page.split('href="/admin/tokens/')[1].split('"')[0]
    assert "API token test of ann?" in admin.ask("GET", f"/admin/tokens/{path}").text
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 200
    assert send(admin, f"/admin/tokens/{path}").location == "/admin/tokens"
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 401
    assert audit_kinds(database)[-1] == ("token_deleted", "root", "198.51.100.7")


def test_an_empty_list_says_where_tokens_are_made(admin: Browser) -> None:
    """In the profile, or by the form above."""
    assert "Nobody has an API token" in admin.ask("GET", "/admin/tokens").text
    assert "There is no join token" in admin.ask("GET", "/admin/join-tokens").text


@pytest.fixture
def site_certificate(app: Flask, tmp_path: Path) -> Iterator[None]:
    """A certificate that the site can tell."""
    with tls_front.running(tmp_path) as running:
        context = app.extensions["robotether"]
        seen = SiteCertificates(SiteAddressSettings("robots.example", 443, running.endpoint))
        app.extensions["robotether"] = dataclasses.replace(context, site_certificates=seen)
        yield


def names(database: Database) -> list[str]:
    """The names of all join tokens."""
    with database.transaction() as tx:
        return [token.name for token in join_tokens.list_all(tx)]


@pytest.mark.usefixtures("site_certificate")
def test_the_line_is_shown_once(admin: Browser, database: Database) -> None:
    """In the answer to the form; it is in no address and no cookie, and the list does not have it."""
    answer = send(admin, "/admin/join-tokens", **FORM)
    assert answer.status_code == 200
    assert "https://robots.example/join.sh | sudo sh" in answer.text
    token = answer.text.split("--token ")[1].split("<")[0]
    assert token.startswith("rj_")
    assert f'data-testid="join-token">{token}<' in answer.text
    assert token not in str(answer.headers)
    page = admin.ask("GET", "/admin/join-tokens").text
    assert token not in page
    assert "3 of 3" in page
    assert names(database) == ["hall"]
    assert audit_kinds(database)[-1] == ("join_token_created", "root", "198.51.100.7")


def test_a_site_that_cannot_tell_its_certificate_makes_no_token(
    admin: Browser, database: Database
) -> None:
    """The form comes back, filled in, with the reason."""
    answer = send(admin, "/admin/join-tokens", **FORM)
    assert (answer.status_code, 'value="hall"' in answer.text) == (503, True)
    assert "certificate" in answer.text
    assert names(database) == []


@pytest.mark.parametrize(
    "wrong", [{"name": ""}, {"uses": "0"}, {"uses": "10001"}, {"hours": "8761"}, {"hours": "x"}]
)
def test_a_wrong_form_comes_back(admin: Browser, database: Database, wrong: dict[str, str]) -> None:
    """With the sentence; no token is made."""
    answer = send(admin, "/admin/join-tokens", **(FORM | wrong))
    assert (answer.status_code, "form-problem" in answer.text) == (422, True)
    assert names(database) == []


@pytest.mark.usefixtures("site_certificate")
def test_a_token_is_deleted_after_a_question(admin: Browser, database: Database) -> None:
    """Which says how many uses are left; the others stay."""
    send(admin, "/admin/join-tokens", **FORM)
    page = admin.ask("GET", "/admin/join-tokens").text
    path = page.split('href="/admin/join-tokens/')[1].split('"')[0]
    send(admin, "/admin/join-tokens", **(FORM | {"name": "yard"}))
    question = admin.ask("GET", f"/admin/join-tokens/{path}").text
    assert "3 of 3 uses are left" in question
    assert send(admin, f"/admin/join-tokens/{path}").location == "/admin/join-tokens"
    assert names(database) == ["yard"]
    assert admin.ask("GET", f"/admin/join-tokens/{path}").status_code == 404

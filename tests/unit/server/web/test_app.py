"""The application as a whole."""

from __future__ import annotations

import os

import pytest
from flask import Flask
from robotether_server.problems import SettingsError
from robotether_server.web.app import MAX_REQUEST_BYTES, make_app
from web_visitor import Browser


def test_large_request_is_refused(program: Browser) -> None:
    """Nobody fills the memory through a form or a join."""
    body = b"x" * (MAX_REQUEST_BYTES + 1)
    kind = "application/json"
    answer = program.ask("POST", "/api/v1/join", data=body, content_type=kind)
    assert answer.status_code == 413


def test_form_cookie_is_kept_from_scripts_and_other_sites(app: Flask) -> None:
    """As the login's cookie is."""
    cookie = Browser(app.test_client()).ask("GET", "/login").headers["Set-Cookie"]
    assert cookie.startswith("__Host-robotether_forms=")
    assert {"Secure", "HttpOnly", "SameSite=Lax", "Path=/"} <= set(cookie.split("; "))
    assert "Domain" not in cookie


ENVIRON = {
    "DB_USER": "web",
    "DB_PASSWORD": "x",
    "TICKET_KEY": "t" * 32,
    "WEB_SECRET_KEY": "w" * 32,
}


def test_application_is_made_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """It answers before the database does."""
    for name, value in ENVIRON.items():
        monkeypatch.setenv(name, value)
    assert make_app().test_client().get("/healthz").text == "ok\n"


def test_wrong_environment_stops_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the sentence of the settings."""
    for name in [*ENVIRON, *(f"{name}_FILE" for name in ENVIRON)]:
        monkeypatch.delenv(name, raising=False)
    assert "DB_USER" not in os.environ
    with pytest.raises(SettingsError):
        make_app()

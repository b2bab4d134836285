"""The application as a whole."""

from __future__ import annotations

from flask import Flask
from robotether_server.web.app import MAX_REQUEST_BYTES
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

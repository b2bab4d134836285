"""The application as a whole, and the security headers of every answer."""

from __future__ import annotations

import os

import pytest
from flask import Flask
from robotether_server.problems import SettingsError
from robotether_server.web.app import MAX_REQUEST_BYTES, content_security_policy, make_app
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


@pytest.mark.parametrize("path", ["/", "/login", "/nothing", "/api/v1/me", "/healthz"])
def test_every_answer_has_them(browser: Browser, path: str) -> None:
    """Nothing runs or loads that this site does not serve, and no other site frames it."""
    headers = browser.ask("GET", path).headers
    policy = headers["Content-Security-Policy"]
    for part in (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self' wss://robots.example;",
        "frame-ancestors 'none'",
    ):
        assert part in policy
    assert "unsafe" not in policy
    assert headers["Cross-Origin-Opener-Policy"] == "same-origin"
    assert headers["Referrer-Policy"] == "same-origin"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"


def test_pages_use_joystick_and_full_screen_and_no_other_device(browser: Browser) -> None:
    """A script that should not be here has no camera, microphone or place to ask for."""
    allowed = browser.ask("GET", "/login").headers["Permissions-Policy"].split(", ")
    assert {"gamepad=(self)", "fullscreen=(self)", "camera=()", "microphone=()"} <= set(allowed)
    assert {part for part in allowed if not part.endswith("=()")} == {
        "gamepad=(self)",
        "fullscreen=(self)",
    }


@pytest.mark.parametrize(
    ("host", "sockets"),
    [
        ("robots.example:8443", "connect-src 'self' wss://robots.example:8443"),
        ("192.0.2.1", "connect-src 'self' wss://192.0.2.1"),
        ("[2001:db8::1]:8443", "connect-src 'self' wss://[2001:db8::1]:8443"),
        ("a; script-src *", "connect-src 'self'"),
        ("*", "connect-src 'self'"),
        ("", "connect-src 'self'"),
    ],
)
def test_policy_names_the_host_and_nothing_that_a_client_made_up(host: str, sockets: str) -> None:
    """Sockets lead to this very host, however it is called."""
    assert sockets in content_security_policy(host).split("; ")


def test_static_files_may_be_kept(browser: Browser) -> None:
    """What is the same for everybody comes out of the browser's cache."""
    answer = browser.ask("GET", "/static/base.css")
    assert answer.status_code == 200
    assert "no-store" not in answer.headers["Cache-Control"]
    answer.close()

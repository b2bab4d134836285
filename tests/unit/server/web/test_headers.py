"""Security headers, on every kind of answer."""

from __future__ import annotations

import pytest
from robotether_server.web.headers import content_security_policy
from web_visitor import Browser


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

"""Security headers, on every kind of answer."""

from __future__ import annotations

import pytest
from web_visitor import Browser


@pytest.mark.parametrize("path", ["/", "/login", "/nothing", "/api/v1/me", "/healthz"])
def test_every_answer_has_them(browser: Browser, path: str) -> None:
    """Nothing runs or loads that this site does not serve, and no other site frames it."""
    headers = browser.ask("GET", path).headers
    policy = headers["Content-Security-Policy"]
    for part in (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self' wss:",
        "frame-ancestors 'none'",
    ):
        assert part in policy
    assert "unsafe" not in policy
    assert headers["Referrer-Policy"] == "same-origin"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"


def test_static_files_may_be_kept(browser: Browser) -> None:
    """What is the same for everybody comes out of the browser's cache."""
    answer = browser.ask("GET", "/static/base.css")
    assert answer.status_code == 200
    assert "no-store" not in answer.headers["Cache-Control"]
    answer.close()

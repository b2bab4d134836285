"""Which pages of other sites may read what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from flask import Flask
from robotether_server.db import Database
from robotether_server.settings import WebSettings
from robotether_server.web import create_app
from web_visitor import Browser, bearer

LAB, OTHER = "https://lab.example", "https://evil.example"
CLIENT = "/static/dist/robotether-client.js"


@pytest.fixture
def lab(app: Flask, web_settings: WebSettings) -> Browser:
    """The lab's page, which may; the application with the people and robots of `app`."""
    assert app
    allowing = create_app(replace(web_settings, allowed_origins=(LAB,)))
    return Browser(allowing.test_client(use_cookies=False))


def asks(method: str, origin: str = LAB) -> dict[str, Any]:
    """The options of a browser's question whether a page may."""
    asked = {"Access-Control-Request-Method": method, "Origin": origin}
    return {"headers": asked | {"Access-Control-Request-Headers": "authorization,content-type"}}


@pytest.mark.parametrize(
    ("path", "method"), [("/api/v1/tickets", "POST"), ("/api/v1/robots", "GET")]
)
def test_a_page_of_an_allowed_site_may_ask(
    lab: Browser, database: Database, path: str, method: str
) -> None:
    """With a token, after a preflight; never with a login."""
    before = lab.ask("OPTIONS", path, **asks(method))
    assert before.status_code == 204
    assert before.headers["Access-Control-Allow-Origin"] == LAB
    assert method in before.headers["Access-Control-Allow-Methods"]
    assert before.headers["Access-Control-Allow-Headers"] == "Authorization, Content-Type"
    body = {"json": {"robot": "sim1", "mode": "drive"}} if method == "POST" else {}
    headers = {"Origin": LAB} | bearer(database, "ann")
    answer = lab.ask(method, path, headers=headers, **body)
    assert answer.status_code in (200, 201)
    for one in (before, answer):
        assert one.headers["Access-Control-Allow-Origin"] == LAB
        assert "Origin" in one.headers["Vary"]
        assert "Access-Control-Allow-Credentials" not in one.headers


def test_a_page_reads_why_it_was_refused(lab: Browser) -> None:
    """A token that does not hold is told as a problem, not as a network that failed."""
    answer = lab.ask("POST", "/api/v1/tickets", headers={"Origin": LAB})
    assert answer.json["code"] == "login_missing"
    assert answer.headers["Access-Control-Allow-Origin"] == LAB


@pytest.mark.parametrize("origin", [OTHER, "null", "", LAB + ".evil.example", "http://lab.example"])
def test_a_page_of_another_site_may_not(lab: Browser, database: Database, origin: str) -> None:
    """Neither its question nor its request gets the header without which a browser keeps the answer from it."""
    before = lab.ask("OPTIONS", "/api/v1/tickets", **asks("POST", origin))
    assert (before.status_code, before.json["code"]) == (403, "origin_refused")
    headers = {"Origin": origin} | bearer(database, "ann")
    answer = lab.ask("GET", "/api/v1/robots", headers=headers)
    for one in (before, answer):
        assert "Access-Control-Allow-Origin" not in one.headers
        assert "Origin" in one.headers["Vary"]


def test_nobody_may_unless_a_site_is_named(program: Browser) -> None:
    """By default this site alone."""
    answer = program.ask("OPTIONS", "/api/v1/tickets", **asks("POST"))
    assert answer.status_code == 403


@pytest.mark.parametrize(
    "path", ["/", "/login", "/api/v1/me", "/api/v1/users", "/api/v1/robots/sim1"]
)
def test_nothing_else_is_for_other_sites(lab: Browser, path: str) -> None:
    """Not even for those that may ask for tickets."""
    for method, options in (("GET", {"headers": {"Origin": LAB}}), ("OPTIONS", asks("GET"))):
        assert "Access-Control-Allow-Origin" not in lab.ask(method, path, **options).headers


def test_any_page_may_load_the_client(
    program: Browser, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As a module, from any site; kept for minutes, so that an upgrade reaches all pages."""
    static = tmp_path / "static"
    (static / "dist").mkdir(parents=True)
    (static / "dist" / "robotether-client.js").write_text("export {};")
    monkeypatch.setattr(program.client.application, "static_folder", str(static))
    answer = program.ask("GET", CLIENT, headers={"Origin": OTHER})
    assert (answer.status_code, answer.mimetype) == (200, "text/javascript")
    assert answer.headers["Access-Control-Allow-Origin"] == "*"
    assert answer.headers["Cache-Control"] == "public, max-age=300"
    answer.close()
    other = program.ask("GET", "/static/base.css", headers={"Origin": OTHER})
    assert "Access-Control-Allow-Origin" not in other.headers

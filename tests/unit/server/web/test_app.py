"""The application as a whole, the security headers of every answer, and which pages of other sites may read what."""

import os
from dataclasses import replace

import pytest
from flask import url_for
from robotether_server.web import create_app
from robotether_server.web.app import MAX_REQUEST_BYTES, content_security_policy, make_app
from web_visitor import Browser, bearer


def test_large_request_is_refused(program):
    """Nobody fills the memory through a form or a join."""
    body = b"x" * (MAX_REQUEST_BYTES + 1)
    answer = program.ask("POST", "/api/v1/join", data=body, content_type="application/json")
    assert answer.status_code == 413


def test_form_cookie_is_kept_from_scripts_and_other_sites(app):
    cookie = Browser(app.test_client()).ask("GET", "/login").headers["Set-Cookie"]
    assert cookie.startswith("__Host-robotether_forms=")
    assert {"Secure", "HttpOnly", "SameSite=Lax", "Path=/"} <= set(cookie.split("; "))
    assert "Domain" not in cookie


ENVIRON = {"DB_USER": "web", "DB_PASSWORD": "x", "TICKET_KEY": "t" * 32, "WEB_SECRET_KEY": "w" * 32}


def test_application_is_made_of_the_environment(monkeypatch):
    """It answers before the database does."""
    for name, value in ENVIRON.items():
        monkeypatch.setenv(name, value)
    client = make_app().test_client()
    assert client.get("/healthz").text == "ok\n"
    # A host that is none is refused, too.
    for host in ("robots..example", "x" * 64):
        assert client.get("/login", headers={"Host": host}).status_code == 400


def test_every_answer_has_them(browser):
    """Nothing runs or loads that this site does not serve, and no other site frames it."""
    for path in ("/", "/login", "/nothing", "/api/v1/me", "/healthz"):
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
        # A script that should not be here has no camera, microphone or place to ask for.
        devices = headers["Permissions-Policy"].split(", ")
        allowed = {part for part in devices if not part.endswith("=()")}
        assert allowed == {"gamepad=(self)", "fullscreen=(self)"}
        assert {"camera=()", "microphone=()"} <= set(devices)


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
def test_policy_names_the_host_and_nothing_that_a_client_made_up(host, sockets):
    """Sockets lead to this very host, however it is called."""
    assert sockets in content_security_policy(host).split("; ")


LAB, OTHER = "https://lab.example", "https://evil.example"


@pytest.fixture
def lab(app, web_settings):
    """The lab's page, which may; the application with the people and robots of `app`."""
    assert app
    allowing = create_app(replace(web_settings, allowed_origins=(LAB,)))
    return Browser(allowing.test_client(use_cookies=False))


def asks(method, origin=LAB):
    asked = {"Access-Control-Request-Method": method, "Origin": origin}
    return {"headers": asked | {"Access-Control-Request-Headers": "authorization,content-type"}}


def test_a_page_of_another_site_may_not(lab, program, database):
    """Neither its question nor its request gets the header without which a browser keeps the answer from it."""
    assert program.ask("OPTIONS", "/api/v1/tickets", **asks("POST")).status_code == 403
    token = bearer(database, "ann")
    for origin in (OTHER, "null", "", LAB + ".evil.example", "http://lab.example"):
        before = lab.ask("OPTIONS", "/api/v1/tickets", **asks("POST", origin))
        assert (before.status_code, before.json["code"]) == (403, "origin_refused")
        answer = lab.ask("GET", "/api/v1/robots", headers={"Origin": origin} | token)
        for item in (before, answer):
            assert "Access-Control-Allow-Origin" not in item.headers
            assert "Origin" in item.headers["Vary"]


def test_nothing_else_is_for_other_sites(lab):
    """Other answers are not shared, even with sites that may ask for tickets."""
    for path in ("/", "/login", "/api/v1/me", "/api/v1/users", "/api/v1/robots/sim1"):
        for method, options in (("GET", {"headers": {"Origin": LAB}}), ("OPTIONS", asks("GET"))):
            assert "Access-Control-Allow-Origin" not in lab.ask(method, path, **options).headers
    # A page must read why it gets no ticket.
    answer = lab.ask("POST", "/api/v1/tickets", headers={"Origin": LAB})
    shared_with = answer.headers["Access-Control-Allow-Origin"]
    assert (answer.json["code"], shared_with) == ("login_missing", LAB)


def test_browser_keeps_a_static_file_until_its_content_changes(program, monkeypatch, tmp_path):
    """What a page of another release asks for is never kept: it would stay after that release is back."""
    application = program.client.application
    monkeypatch.setattr(application, "static_folder", str(tmp_path))
    sheet = tmp_path / "base.css"

    def address_of(text, modified_s):
        sheet.write_text(text)
        os.utime(sheet, (modified_s, modified_s))
        with application.test_request_context():
            return url_for("static", filename="base.css")

    before, now = address_of("a {}", 1), address_of("b {}", 2)
    assert before != now
    for address, kept in ((now, True), (before, False), ("/static/base.css", False)):
        with program.ask("GET", address) as answer:
            assert (answer.text, "immutable" in answer.headers["Cache-Control"]) == ("b {}", kept)

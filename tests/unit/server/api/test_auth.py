"""Who asks: logins and tokens that hold, and everything else that does not."""

import pytest
from api_visitor import in_person
from robotether_server.api import auth
from robotether_server.db import credentials
from robotether_server.relay.auth.access import LOGIN_COOKIE
from robotether_server.tickets import TicketSigner
from web_visitor import Browser, audit_kinds

TICKET = {"robot": "sim1", "mode": "drive"}
IN_PATHS = {"robot": "sim1", "user": "root", "group": "crew", "site": "lab"}
IN_PATHS |= dict.fromkeys(("token_id", "key_id", "grant_id"), "1")


def for_admins(program):
    """Method and path of everything that the description tags so, with names that exist."""
    paths = program.ask("GET", "/api/v1/openapi.json").json["paths"]
    for path, item in paths.items():
        for method in {"get", "post", "put", "patch", "delete"} & set(item):
            if "admin" in item[method].get("tags", []):
                yield method.upper(), path.format(**IN_PATHS).removeprefix("/api/v1")


def test_token_that_does_not_hold_is_refused(browser):
    browser.log_in("ann")
    for header in ("Bearer rt_nobodys", "Bearer", "Basic YTpi", ""):
        answer = browser.ask("GET", "/api/v1/me", headers={"Authorization": header})
        assert (answer.status_code, answer.json["code"]) == (401, "token_invalid"), header


def test_login_tells_who_asks(browser):
    """The cookie is kept from scripts, other sites and plain HTTP, and no neighbouring host can set it (`__Host-`)."""
    cookie = browser.log_in("ann").headers.getlist("Set-Cookie")[0]
    assert cookie.startswith("__Host-robotether_login=")
    parts = cookie.split("; ")
    assert {"Secure", "HttpOnly", "SameSite=Lax", "Path=/", "Max-Age=43200"} <= set(parts)
    assert "Domain" not in cookie
    assert auth.COOKIE == LOGIN_COOKIE
    assert browser.ask("GET", "/api/v1/me").json == {"name": "ann", "role": "user"}


def test_a_ticket_names_the_login_that_asked_for_it(browser):
    """What it opens ends when this browser logs out, and not when another one does."""
    answer = in_person(browser, "ann").ask("POST", "/tickets", TICKET)
    ticket, _ = TicketSigner("t" * 32, 30).verify(answer.json["ticket"])
    cookie = browser.client.get_cookie("__Host-robotether_login", "robots.example")
    sha256 = credentials.digest(cookie.value).hex()
    assert (ticket.credential, ticket.credential_sha256) == ("login", sha256)


def age(admin_database, hours):
    """Have so much time pass since all logins were made, and last used."""
    with admin_database.transaction() as tx:
        tx.change(
            "UPDATE logins SET expires_at = expires_at - INTERVAL %(s)s SECOND, "
            "created_at = created_at - INTERVAL %(s)s SECOND",
            {"s": hours * 3600},
        )


@pytest.mark.parametrize(("between_h", "uses", "last_h"), [(3.9, 2, 4.1), (1, 11, 1.1)])
def test_a_login_ends_after_12_hours_or_4_without_use(
    browser, admin_database, between_h, uses, last_h
):
    browser.log_in("ann")
    for _ in range(uses):
        age(admin_database, between_h)
        assert browser.ask("GET", "/").status_code == 200
    age(admin_database, last_h)
    assert browser.ask("GET", "/").status_code == 302


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [("POST", "/tickets", TICKET), ("PUT", "/queue/me", {}), ("GET", "/requests", None)],
)
def test_a_page_that_nobody_touches_keeps_no_login(browser, admin_database, method, path, body):
    """It asks for tickets and requests by itself, as often as its connections are cut."""
    ann = in_person(browser, "ann")
    age(admin_database, 2.1)
    assert ann.ask(method, path, body).status_code < 300
    age(admin_database, 2.1)
    assert ann.ask(method, path, body).status_code == 401


def test_others_are_refused_before_anything_is_looked_at(program, ann, database):
    paths = list(for_admins(program))
    assert len(paths) > 20
    for method, path in paths:
        for asked in (path, path.replace("sim1", "ghost").replace("root", "ghost")):
            assert ann.refused(method, asked, {"rubbish": 1}) == (403, "grant_missing"), asked
    assert audit_kinds(database) == []


def test_login_changes_nothing_without_the_pages_token(app, program):
    """Another site could send the cookie along."""
    browser = Browser(app.test_client())
    browser.log_in("root")
    for method, path in for_admins(program):
        answer = browser.ask(method, f"/api/v1{path}", json={"rubbish": 1})
        if method != "GET":
            assert (answer.status_code, answer.json["code"]) == (403, "csrf_refused"), path
    root = in_person(browser, "root")
    assert root.ask("PUT", "/grants/ann/sim2", {"level": "observe"}).status_code == 200


def test_join_token_opens_nothing_but_enrolment(program, root, site_certificate):
    """It is a shared secret that stands on robots."""
    body = {"name": "fleet", "uses": 2, "hours": 1}
    token = root.ask("POST", "/join-tokens", body).json["token"]
    headers = {"Authorization": f"Bearer {token}"}
    asked = [*for_admins(program), ("GET", "/robots"), ("GET", "/me"), ("GET", "/robots/sim1")]
    for method, path in asked:
        answer = program.ask(method, f"/api/v1{path}", json={}, headers=headers)
        assert (answer.status_code, answer.json["code"]) == (401, "token_invalid"), path

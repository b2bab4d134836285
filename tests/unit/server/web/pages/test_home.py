"""The pages: in and out, what each needs, and where a visitor is sent."""

import html
import json
import re
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from relay_server import cell_settings
from robotether_server.contract.codes import DRIVE_ENDS, REFUSALS
from robotether_server.db import cells
from robotether_server.settings.robot import parse
from robotether_server.times import utc_now
from web_visitor import PASSWORD, Browser, audit_kinds


def test_login_sends_nobody_to_another_site(browser):
    hosts = ("https://evil.example/", "//evil.example", "/\\evil.example", "/\t/evil.example")
    for onward in (*hosts, "javascript:x", ""):
        assert browser.log_in("ann", onward=onward).location == "/", onward
        browser.client.delete_cookie("__Host-robotether_login", domain="robots.example")


def test_guesses_sent_at_once_are_counted_before_they_are_checked(app, database):
    """Of twelve no more than five are checked, as when they come one after the other."""
    together = threading.Barrier(12)
    visitors = [Browser(app.test_client()) for _ in range(12)]
    forms = [
        {"csrf_token": visitor.csrf(), "name": "ann", "password": "wrong"} for visitor in visitors
    ]

    def guess(number):
        together.wait(20)
        return visitors[number].ask("POST", "/login", data=forms[number]).status_code

    with ThreadPoolExecutor(12) as threads:
        answers = Counter(threads.map(guess, range(12)))
    assert answers == {401: 5, 429: 7}
    assert audit_kinds(database) == [("login_failed", "ann", "198.51.100.7")] * 5


def test_form_without_its_token_is_refused(browser, database):
    """Another site cannot log a visitor in as somebody else."""
    answer = browser.ask("POST", "/login", data={"name": "ann", "password": "x"})
    assert answer.status_code == 403
    assert audit_kinds(database) == []


def test_login_and_logout_leave_audit_events(browser, database):
    browser.log_in("ann")
    cookie = browser.client.get_cookie("__Host-robotether_login", "robots.example")
    assert browser.ask("POST", "/logout").status_code == 403
    answer = browser.ask("POST", "/logout", data={"csrf_token": browser.csrf_of("/")})
    assert answer.location == "/login"
    browser.client.set_cookie(
        "__Host-robotether_login", cookie.value, domain="robots.example", secure=True
    )
    assert browser.ask("GET", "/").status_code == 302
    assert audit_kinds(database) == [
        ("login", "ann", "198.51.100.7"),
        ("logout", "ann", "198.51.100.7"),
    ]


def test_sixth_try_waits(browser, database):
    for blanks in range(5):
        assert browser.log_in(" " * blanks + "ann" + " " * blanks, "wrong").status_code == 401
    answer = browser.log_in("ann")
    assert answer.status_code == 429
    assert "try again at" in answer.text
    assert 500 < int(answer.headers["Retry-After"]) <= 600
    assert [(kind, actor) for kind, actor, _ in audit_kinds(database)] == [
        ("login_failed", "ann")
    ] * 5


def test_client_cannot_choose_its_address(browser, database):
    """Only the address that nginx found counts, the last one."""
    form = {"csrf_token": browser.csrf(), "name": "ann", "password": "wrong"}
    forged = {"X-Forwarded-For": "203.0.113.1, 198.51.100.7", "X-Real-IP": "203.0.113.2"}
    browser.ask("POST", "/login", data=form, headers=forged)
    assert audit_kinds(database) == [("login_failed", "ann", "198.51.100.7")]


def test_drive_page_has_the_robots_settings_and_the_words_of_codes(browser, database):
    """All that are in force reach the page's script as data, the defaults included."""
    browser.log_in("ann")

    def data_of_page(name):
        page = browser.ask("GET", "/robots/sim1").text
        [found] = re.findall(f"data-{name}='([^']*)'", page)
        return json.loads(html.unescape(found))

    def settings_of_page(settings):
        with database.transaction() as tx:
            tx.change("UPDATE robots SET settings = %s WHERE name = 'sim1'", (settings,))
        return data_of_page("settings")

    assert data_of_page("words") == {"ends": DRIVE_ENDS, "refusals": REFUSALS}
    name = "\"'<&"
    given = {"page": {"hold_after_ms": None, "cameras": [{"topic": "/front", "name": name}]}}
    assert settings_of_page(json.dumps(given)) == parse(given).as_dict()
    # What somebody wrote by SQL keeps drivers out at the relay; the page shows the robot as by default.
    wrong = settings_of_page('{"page": {"hold_after_ms": 99999}}')
    assert wrong == parse({}).as_dict()


def test_everybody_gets_stop_and_only_drivers_the_release(browser):
    for name, may_release in (("olga", False), ("ann", True)):
        browser.log_in(name)
        page = browser.ask("GET", "/robots/sim1").text
        assert 'data-testid="stop"' in page
        assert ('data-testid="release"' in page) is may_release
        browser.client.delete_cookie("__Host-robotether_login", domain="robots.example")


def test_fleet_page_may_measure_the_sites_other_machines(app, browser, database, relay_database):
    """Not its own by any name, and none that is taken out of service or has no address; other pages may ask none."""
    settings = replace(
        app.extensions["robotether"].site_certificates.settings, public_host="a.example"
    )
    app.extensions["robotether"].site_certificates.settings = settings
    browser.log_in("ann")
    with relay_database.transaction() as tx:
        for name, host in (
            ("a", "a.example"),
            ("b", "b.example"),
            ("c", "c.example"),
            ("d", None),
        ):
            cells.write_heartbeat(tx, cell_settings(name, host), cells.CellCounts(), utc_now())
    with database.transaction() as tx:
        cells.set_draining(tx, "c", on=True)
    answer = browser.ask("GET", "/")
    [machines] = re.findall(r'data-machines="([^"]*)"', answer.text)
    assert json.loads(html.unescape(machines)) == [{"name": "b", "authority": "b.example"}]
    policy = "connect-src 'self' wss://robots.example"
    for path, own in (("/", f"{policy} https://b.example"), ("/wall", policy)):
        headers = browser.ask("GET", path).headers
        assert own in headers["Content-Security-Policy"].split("; "), path


@pytest.mark.parametrize("name", ["sim2", "ghost"])
def test_robot_that_may_not_be_seen_is_not_there(browser, name):
    browser.log_in("ann")
    page = browser.ask("GET", f"/robots/{name}")
    assert page.status_code == 404
    assert f"No robot &#39;{name}&#39;, or you have no access." in page.text


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("https://robots.example", 303),
        ("https://Robots.example:443", 303),
        ("null", 303),
        ("https://front.example", 403),
        ("https://robots.example:9443", 403),
    ],
)
def test_a_proxy_that_rewrites_host_is_named_at_log_in(browser, origin, status):
    """Behind it the pages would work, and driving and Stop would not."""
    form = {"csrf_token": browser.csrf(), "name": "ann", "password": PASSWORD, "next": ""}
    answer = browser.ask("POST", "/login", data=form, headers={"Origin": origin})
    assert answer.status_code == status, answer.text
    assert ("let it pass Host on unchanged" in answer.text) == (status == 403)

"""A robot is added in three steps: which one, the line to run on it, its arrival; or announced by its MAC."""

import dataclasses
import shlex
from html import unescape

import pytest
import tls_front
from admin_visitor import send
from robotether_server.db import join_tokens, robots
from robotether_server.install_line import SiteCertificates
from robotether_server.settings.server import SiteAddressSettings
from web_visitor import audit_kinds

FORM = {"name": "", "uses": "1", "hours": "1"}


@pytest.fixture
def site_certificate(app, tmp_path):
    with tls_front.running(tmp_path) as running:
        context = app.extensions["robotether"]
        seen = SiteCertificates(SiteAddressSettings("robots.example", 443, running.endpoint))
        app.extensions["robotether"] = dataclasses.replace(context, site_certificates=seen)
        yield


def names(database):
    with database.transaction() as tx:
        return [token.name.rpartition(" ")[0] for token in join_tokens.list_all(tx)]


def live_of(page):
    """Where the page asks who has come."""
    return page.split('data-live="')[1].split('"')[0]


def words_of(page):
    line = unescape(page.split('data-testid="install-line">')[1].split("<", maxsplit=1)[0])
    assert line.startswith("curl -fsSk --pinnedpubkey")
    assert " https://robots.example/join.sh | sudo sh -s -- " in line
    return shlex.split(line)


@pytest.mark.usefixtures("site_certificate")
def test_the_line_is_shown_once_and_its_token_revoked_after_a_question(admin, database):
    answer = send(admin, "/admin/join-tokens", **FORM)
    assert answer.status_code == 200
    token = words_of(answer.text)[-1]
    assert token.startswith("rj_")
    assert f'data-testid="join-token">{token}<' in answer.text
    assert token not in str(answer.headers)
    for path in (live_of(answer.text), "/admin/add-robot"):
        page = admin.ask("GET", path).text
        assert token not in page
        assert "1 of 1" in page
    assert names(database) == ["robot"]
    assert audit_kinds(database)[-1] == ("join_token_created", "root", "198.51.100.7")
    path = page.split('href="/admin/join-tokens/')[1].split('"')[0]
    send(admin, "/admin/join-tokens", **(FORM | {"name": "yard", "uses": "1"}))
    assert "1 of 1 uses are left" in admin.ask("GET", f"/admin/join-tokens/{path}").text
    assert send(admin, f"/admin/join-tokens/{path}").location == "/admin/add-robot"
    assert names(database) == ["yard"]
    assert admin.ask("GET", f"/admin/join-tokens/{path}").status_code == 404


def test_a_robot_is_announced(admin, database):
    """Its page follows; a local MAC may be allowed by a box."""
    answer = send(admin, "/admin/add-robot", name="lift", mac="00-1B-44-11-3A-B7")
    assert (answer.status_code, answer.location) == (303, "/admin/robots/lift")
    assert "Robot lift is announced" in admin.ask("GET", "/admin/robots/lift").text
    with database.transaction() as tx:
        assert robots.get(tx, "lift").mac == "00:1b:44:11:3a:b7"
    vm = {"name": "vm", "mac": "06:00:00:00:00:01"}
    assert send(admin, "/admin/add-robot", **vm).status_code == 422
    assert send(admin, "/admin/add-robot", local_mac="yes", **vm).status_code == 303


def test_what_is_no_number_is_refused(admin, database):
    """Python would take some of these."""
    for uses in ("0", "10001", "-1", "1_0", "1.5", "\u0661", "1e1", "9" * 5000):
        answer = send(admin, "/admin/join-tokens", **FORM | {"uses": uses})
        assert (answer.status_code, "whole number from 1 to" in answer.text) == (422, True), uses
    assert names(database) == []

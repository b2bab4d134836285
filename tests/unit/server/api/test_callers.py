"""Who gets in at all: every path that is for admins, asked by everybody else."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from api_visitor import Program
from flask import Flask
from robotether_server.api.callers import check_admin
from robotether_server.db import Database
from robotether_server.db.users import User
from robotether_server.problems import GrantMissing
from web_visitor import Browser, audit_kinds

IN_PATHS = {"robot": "sim1", "user": "root", "group": "crew", "site": "lab"}
IN_PATHS |= dict.fromkeys(("token_id", "key_id", "grant_id"), "1")
METHODS = {"get", "post", "put", "patch", "delete"}


def for_admins(program: Browser) -> Iterator[tuple[str, str]]:
    """Method and path of everything that the description tags so, with names that exist."""
    paths = program.ask("GET", "/api/v1/openapi.json").json["paths"]
    for path, item in paths.items():
        for method in METHODS & set(item):
            if "admin" in item[method].get("tags", []):
                real = path.format(**IN_PATHS)
                yield method.upper(), real.removeprefix("/api/v1")


def test_others_are_refused_before_anything_is_looked_at(
    program: Browser, ann: Program, database: Database
) -> None:
    """The same answer for what exists and what does not, whatever the body; and nothing happens."""
    paths = list(for_admins(program))
    assert len(paths) > 20
    for method, path in paths:
        for asked in (path, path.replace("sim1", "ghost").replace("root", "ghost")):
            assert ann.refused(method, asked, {"rubbish": 1}) == (403, "grant_missing"), asked
    assert audit_kinds(database) == []


def test_nobody_is_told_to_log_in(program: Browser) -> None:
    """401 before all else."""
    for method, path in for_admins(program):
        answer = program.ask(method, f"/api/v1{path}", json={"rubbish": 1})
        assert (answer.status_code, answer.json["code"]) == (401, "login_missing"), path


def test_login_changes_nothing_without_the_pages_token(app: Flask, program: Browser) -> None:
    """Another site could send the cookie along."""
    browser = Browser(app.test_client())
    browser.log_in("root")
    for method, path in for_admins(program):
        answer = browser.ask(method, f"/api/v1{path}", json={"rubbish": 1})
        if method != "GET":
            assert (answer.status_code, answer.json["code"]) == (403, "csrf_refused"), path
    headers = {"X-CSRFToken": browser.csrf_of("/")}
    body = {"level": "observe"}
    answer = browser.ask("PUT", "/api/v1/grants/ann/sim2", json=body, headers=headers)
    assert answer.status_code == 200


def test_join_token_opens_nothing_but_enrolment(
    program: Browser, root: Program, site_certificate: None
) -> None:
    """It is a shared secret that stands on robots."""
    body = {"name": "fleet", "uses": 2, "hours": 1}
    token = root.ask("POST", "/join-tokens", body).json["token"]
    headers = {"Authorization": f"Bearer {token}"}
    asked = [*for_admins(program), ("GET", "/robots"), ("GET", "/me"), ("GET", "/robots/sim1")]
    for method, path in asked:
        answer = program.ask(method, f"/api/v1{path}", json={}, headers=headers)
        assert (answer.status_code, answer.json["code"]) == (401, "token_invalid"), path


def test_failure_leaves_nothing_behind(root: Program, database: Database) -> None:
    """What a request did before it failed is undone, with its audit events."""
    body = {"shell": True, "name": "sim2"}
    assert root.refused("PATCH", "/robots/sim1", body) == (409, "record_exists")
    assert root.get("/robots/sim1")["shell_port"] is None
    assert audit_kinds(database) == []


def test_deeds_are_signed_with_name_and_address(root: Program, database: Database) -> None:
    """As nginx saw it."""
    root.ask("PATCH", "/robots/sim1", {"shell": True})
    assert [(actor, address) for _, actor, address in audit_kinds(database)] == [
        ("root", "198.51.100.7")
    ]


def test_only_admins_are_admins() -> None:
    """The role alone counts."""
    check_admin(User(1, "root", "admin", False, ""))
    with pytest.raises(GrantMissing, match="ann"):
        check_admin(User(2, "ann", "user", False, ""))

"""Join tokens: told once, with the line that installs a robot."""

from __future__ import annotations

import shlex

import pytest
from api_visitor import Program
from robotether_server.db import Database
from web_visitor import audit_kinds

BODY = {"name": "lab", "uses": 3, "hours": 24}


def test_token_is_told_once_with_its_line(
    root: Program, site_certificate: None, database: Database
) -> None:
    """The line names the host that the admin's own request went to."""
    answer = root.ask("POST", "/join-tokens", BODY)
    assert answer.status_code == 201
    made = answer.json
    command = made.pop("command")
    token = made.pop("token")
    assert token.startswith("rj_")
    assert shlex.split(command)[-1] == token
    assert "https://robots.example/join.sh | sudo sh -s -- --server robots.example " in command
    assert (made["name"], made["uses"], made["used"], made["created_by"]) == ("lab", 3, 0, "root")
    assert root.get("/join-tokens") == {"join_tokens": [made]}
    assert audit_kinds(database) == [("join_token_created", "root", "198.51.100.7")]


def test_deleted_token_is_gone(root: Program, site_certificate: None) -> None:
    """Once."""
    path = f"/join-tokens/{root.ask('POST', '/join-tokens', BODY).json['id']}"
    assert root.ask("DELETE", path).status_code == 204
    assert root.get("/join-tokens") == {"join_tokens": []}
    assert root.refused("DELETE", path) == (404, "record_missing")


def test_token_without_its_line_is_not_made(root: Program, database: Database) -> None:
    """When nginx does not show its certificate, the admin tries again with the same name."""
    assert root.refused("POST", "/join-tokens", BODY) == (503, "front_unavailable")
    assert root.get("/join-tokens") == {"join_tokens": []}
    assert audit_kinds(database) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"name": ""},
        {"name": "x" * 64},
        {"name": "a\x1b[2J"},
        {"uses": 0},
        {"uses": 10001},
        {"uses": True},
        {"hours": 0},
        {"hours": 8761},
        {"hours": "24"},
        {"use": 1},
    ],
)
def test_wrong_field_is_refused(
    root: Program, site_certificate: None, changes: dict[str, object]
) -> None:
    """Before anything is made."""
    assert root.refused("POST", "/join-tokens", BODY | changes) == (422, "field_invalid")


def test_longest_token_is_allowed(root: Program, site_certificate: None) -> None:
    """The bounds are those of the description."""
    body = {"name": "longest", "uses": 10000, "hours": 8760}
    assert root.ask("POST", "/join-tokens", body).status_code == 201


def test_name_is_taken_once(root: Program, site_certificate: None) -> None:
    """So that a list tells them apart."""
    root.ask("POST", "/join-tokens", BODY)
    assert root.refused("POST", "/join-tokens", BODY) == (409, "record_exists")

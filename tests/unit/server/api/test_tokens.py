"""API tokens: everybody's own, and all of them for admins."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest
from api_visitor import API, Program
from web_visitor import Browser


def names(program: Program) -> list[tuple[str, str]]:
    return [(one["user"], one["name"]) for one in program.get("/tokens")["tokens"]]


def test_token_is_told_once_and_works(program: Browser, ann: Program) -> None:
    """For the user who made it, until it is deleted."""
    answer = ann.ask("POST", "/tokens", {"name": "script"})
    assert answer.status_code == 201
    made = answer.json
    headers = {"Authorization": f"Bearer {made.pop('token')}"}
    assert (made["user"], made["name"], made["expires_at"]) == ("ann", "script", None)
    assert made in ann.get("/tokens")["tokens"]
    assert program.ask("GET", f"{API}/me", headers=headers).json["name"] == "ann"
    assert ann.ask("DELETE", f"/tokens/{made['id']}").status_code == 204
    assert program.ask("GET", f"{API}/me", headers=headers).status_code == 401
    assert ann.refused("DELETE", f"/tokens/{made['id']}") == (404, "record_missing")


def test_token_may_end(ann: Program) -> None:
    """After the days that were asked for."""
    made = ann.ask("POST", "/tokens", {"name": "short", "days": 2}).json
    left = dt.datetime.fromisoformat(made["expires_at"]) - dt.datetime.now(dt.UTC)
    assert dt.timedelta(days=1, hours=23) < left <= dt.timedelta(days=2)


def test_users_see_and_delete_only_their_own(ann: Program, root: Program) -> None:
    """Another's looks like one that does not exist; an admin may delete any."""
    assert names(ann) == [("ann", "test")]
    assert names(root) == [("ann", "test"), ("root", "test")]
    ids = {one["user"]: one["id"] for one in root.get("/tokens")["tokens"]}
    assert ann.refused("DELETE", f"/tokens/{ids['root']}") == (404, "record_missing")
    assert ann.refused("DELETE", "/tokens/999999999999999999999") == (404, "record_missing")
    assert root.ask("DELETE", f"/tokens/{ids['ann']}").status_code == 204
    assert ann.refused("GET", "/me") == (401, "token_invalid")


def test_only_admins_make_tokens_for_others(ann: Program, root: Program) -> None:
    """One's own name does no harm."""
    assert ann.ask("POST", "/tokens", {"name": "a", "user": "ann"}).status_code == 201
    for other in ("root", "ghost"):
        refusal = ann.refused("POST", "/tokens", {"name": "b", "user": other})
        assert refusal == (403, "grant_missing")
    assert root.ask("POST", "/tokens", {"name": "b", "user": "olga"}).json["user"] == "olga"
    refusal = root.refused("POST", "/tokens", {"name": "b", "user": "ghost"})
    assert refusal == (404, "record_missing")


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"name": ""},
        {"name": "a", "days": 0},
        {"name": "a", "days": 3651},
        {"name": "a", "day": 1},
    ],
)
def test_wrong_field_is_refused(ann: Program, body: dict[str, Any]) -> None:
    """Unknown ones too: a token that was to end must not live for ever."""
    assert ann.refused("POST", "/tokens", body) == (422, "field_invalid")


def test_name_is_taken_once(ann: Program) -> None:
    """For each user."""
    assert ann.refused("POST", "/tokens", {"name": "test"}) == (409, "record_exists")

"""API tokens and join tokens through the API."""

import datetime as dt

import pytest
from api_visitor import in_person
from robotether_server.db import join_tokens
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.db.join_tokens import Place
from web_visitor import audit_kinds


def names(program):
    return [(token["user"], token["name"]) for token in program.get("/tokens")["tokens"]]


@pytest.mark.parametrize(("given", "days"), [({}, 365), ({"days": 2}, 2)])
def test_token_ends_by_itself(browser, given, days):
    made = in_person(browser, "ann").ask("POST", "/tokens", {"name": "script"} | given).json
    left = dt.datetime.fromisoformat(made["expires_at"]) - dt.datetime.now(dt.UTC)
    assert round(left / dt.timedelta(days=1)) == days


def test_users_see_and_delete_only_their_own(ann, root):
    """Another's looks like one that does not exist; an admin may delete any."""
    assert names(ann) == [("ann", "test")]
    assert names(root) == [("ann", "test"), ("root", "test")]
    ids = {token["user"]: token["id"] for token in root.get("/tokens")["tokens"]}
    assert ann.refused("DELETE", f"/tokens/{ids['root']}") == (404, "record_missing")
    assert ann.refused("DELETE", "/tokens/999999999999999999999") == (404, "record_missing")
    assert root.ask("DELETE", f"/tokens/{ids['ann']}").status_code == 204
    assert ann.refused("GET", "/me") == (401, "token_invalid")


def test_only_admins_make_tokens_for_others(browser):
    ann = in_person(browser, "ann")
    assert ann.ask("POST", "/tokens", {"name": "a", "user": "ann"}).status_code == 201
    for other in ("root", "ghost"):
        refusal = ann.refused("POST", "/tokens", {"name": "b", "user": other})
        assert refusal == (403, "grant_missing")
    root = in_person(browser, "root")
    assert root.ask("POST", "/tokens", {"name": "b", "user": "olga"}).json["user"] == "olga"
    refusal = root.refused("POST", "/tokens", {"name": "b", "user": "ghost"})
    assert refusal == (404, "record_missing")


JOIN_TOKEN = {"name": "lab", "uses": 3, "hours": 24}


def test_join_token_says_where_its_robots_belong(root, site_certificate, database):
    place = {"site": "hall", "group": "crew", "region": "eu"}
    assert root.refused("POST", "/join-tokens", JOIN_TOKEN | place) == (404, "record_missing")
    with database.transaction() as tx:
        SITES.add(tx, "hall")
        GROUPS.add(tx, "crew")
    made = root.ask("POST", "/join-tokens", JOIN_TOKEN | place).json
    with database.transaction() as tx:
        assert join_tokens.place_of(tx, made["id"]) == Place("hall", "crew", "eu")


def test_join_token_without_its_line_is_not_made(root, database):
    """When nginx does not show its certificate, the admin tries again with the same name."""
    assert root.refused("POST", "/join-tokens", JOIN_TOKEN) == (503, "front_unavailable")
    assert root.get("/join-tokens") == {"join_tokens": []}
    assert audit_kinds(database) == []

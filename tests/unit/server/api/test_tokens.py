"""API tokens and join tokens through the API."""

import datetime as dt

from api_visitor import in_person
from web_visitor import audit_kinds


def names(program):
    return [(token["user"], token["name"]) for token in program.get("/tokens")["tokens"]]


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
    """Whether there is another user is not told to others."""
    ann = in_person(browser, "ann")
    for other in ("root", "ghost"):
        refusal = ann.refused("POST", "/tokens", {"name": "b", "user": other})
        assert refusal == (403, "grant_missing")
    root = in_person(browser, "root")
    for days, expected in (({}, 365), ({"days": 2}, 2)):
        body = {"name": f"b{expected}", "user": "olga"} | days
        made = root.ask("POST", "/tokens", body).json
        left = dt.datetime.fromisoformat(made["expires_at"]) - dt.datetime.now(dt.UTC)
        assert (made["user"], round(left / dt.timedelta(days=1))) == ("olga", expected)


JOIN_TOKEN = {"name": "lab", "uses": 3, "hours": 24}


def test_join_token_without_its_line_is_not_made(root, database):
    """When nginx does not show its certificate, the admin tries again with the same name."""
    assert root.refused("POST", "/join-tokens", JOIN_TOKEN) == (503, "front_unavailable")
    assert root.get("/join-tokens") == {"join_tokens": []}
    assert audit_kinds(database) == []

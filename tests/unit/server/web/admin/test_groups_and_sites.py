"""The pages of groups and of sites."""

from __future__ import annotations

import datetime as dt

import pytest
from admin_visitor import send
from robotether_server.db import join_tokens
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.db.join_tokens import Place


@pytest.mark.parametrize(
    ("collection", "member_kind", "member", "removal"),
    [(GROUPS, "user", "ann", "remove"), (SITES, "robot", "sim1", "take-out")],
)
def test_collection_is_added_filled_and_removed(*, admin, collection, member_kind, member, removal):
    """Each step has its page and its question; services/test_grants.py has the lines of the log."""
    path = f"/admin/{collection.kind}s"
    fill = f"{path}/x/{collection.members}"
    remove = f"{fill}/{member}/{removal}"

    def has_member():
        return f'href="{remove}"' in admin.ask("GET", f"{path}/x").text

    assert send(admin, path, name="x").location == f"{path}/x"
    assert not has_member()
    assert send(admin, fill, **{member_kind: member}).location == f"{path}/x"
    assert has_member()
    assert f"Add {member} again" in admin.ask("GET", remove).text
    assert send(admin, remove).location == f"{path}/x"
    assert not has_member()
    assert send(admin, remove).status_code >= 400
    send(admin, fill, **{member_kind: member})
    assert f": {member}." in admin.ask("GET", f"{path}/x/remove").text
    assert send(admin, f"{path}/x/remove").location == path
    assert admin.ask("GET", f"{path}/x").status_code == 404


def test_robot_is_moved_from_its_own_page(admin):
    assert "There is no site yet" in admin.ask("GET", "/admin/robots/sim1").text
    send(admin, "/admin/sites", name="lab")
    for site, is_there in (("lab", True), ("", False)):
        send(admin, "/admin/robots/sim1/site", site=site)
        found = admin.ask("GET", "/admin/robots?q=lab").text
        assert ('data-testid="row-sim1"' in found) is is_there
    answer = send(admin, "/admin/sites/lab/robots/sim1/take-out")
    assert (answer.status_code, "it is not there" in answer.text) == (409, True)
    assert send(admin, "/admin/sites/lab/robots/ghost/take-out").status_code == 404


@pytest.mark.parametrize(
    ("kind", "place"), [("group", "given to no group"), ("site", "at no site")]
)
def test_question_names_the_join_tokens_that_lose_the_record(admin, database, kind, place):
    now = dt.datetime.now(dt.UTC)
    later, past = (now + dt.timedelta(hours=hours) for hours in (1, -1))
    send(admin, f"/admin/{kind}s", name="x")
    page = f"/admin/{kind}s/x/remove"
    assert "these tokens" not in admin.ask("GET", page).text
    with database.transaction() as tx:
        for token, ends_at in (("b", later), ("<a>", later), ("old", past)):
            join_tokens.create(tx, token, 1, ends_at, "root", place=Place(**{kind: "x"}))
        join_tokens.create(tx, "elsewhere", 1, later, "root")
    assert f"with these tokens will be {place}: &lt;a&gt;, b.<" in admin.ask("GET", page).text

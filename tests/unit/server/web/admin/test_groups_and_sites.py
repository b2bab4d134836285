"""The pages of groups and of sites."""

from __future__ import annotations

import datetime as dt
from typing import Any, NamedTuple

import pytest
from admin_visitor import send
from robotether_server.db import join_tokens, robots
from robotether_server.db.grants import GROUPS, SITES, Collection
from robotether_server.db.join_tokens import Place
from web_visitor import audit_kinds


class Case(NamedTuple):
    """A collection with a member, the end of the path that removes it, and what the log says of both changes."""

    collection: Collection[Any]
    member_kind: str
    member: str
    removal: str
    audit_kinds: tuple[str, str]


CASES = [
    Case(GROUPS, "user", "ann", "remove", ("group_member_added", "group_member_removed")),
    Case(SITES, "robot", "sim1", "take-out", ("robot_site_set", "robot_site_set")),
]


@pytest.mark.parametrize("case", CASES)
def test_collection_is_added_filled_and_removed(admin, database, case):
    """Each step has its page, its question and its line in the log."""

    def members():
        with database.transaction() as tx:
            return tuple(case.collection.get(tx, "x").members)

    kind, member = case.collection.kind, case.member
    path = f"/admin/{kind}s"
    fill = f"{path}/x/{case.collection.members}"
    remove = f"{fill}/{member}/{case.removal}"
    assert f"There is no {kind} yet" in admin.ask("GET", path).text
    assert send(admin, path, name="x").location == f"{path}/x"
    page, choice = admin.ask("GET", f"{path}/x").text, f'<option value="{member}">'
    assert (f'href="{remove}"' in page, choice in page) == (False, True)
    assert send(admin, fill, **{case.member_kind: member}).location == f"{path}/x"
    assert members() == (member,)
    assert member in admin.ask("GET", path).text
    assert f"{path}/x" in admin.ask("GET", f"/admin/{case.member_kind}s/{member}").text
    page = admin.ask("GET", f"{path}/x").text
    assert (f'href="{remove}"' in page, choice in page) == (True, False)
    assert f"Add {member} again" in admin.ask("GET", remove).text
    assert members() == (member,)
    assert send(admin, remove).location == f"{path}/x"
    assert members() == ()
    assert send(admin, remove).status_code >= 400
    send(admin, fill, **{case.member_kind: member})
    assert f": {member}." in admin.ask("GET", f"{path}/x/remove").text
    assert send(admin, f"{path}/x/remove").location == path
    assert admin.ask("GET", f"{path}/x").status_code == 404
    assert [each for each, *_ in audit_kinds(database)][-5:] == [
        f"{kind}_added",
        *case.audit_kinds,
        case.audit_kinds[0],
        f"{kind}_removed",
    ]


def test_wrong_field_is_marked(admin):
    """What to enter stands at its label, the focus is there, and the summary leads to it."""
    page = send(admin, "/admin/groups", name="The Crew").text
    assert 'aria-invalid="true" autofocus aria-describedby="name-problem name-hint"' in page
    assert '<p class="wrong" id="name-problem">Enter 1 to 63 characters' in page
    assert '<p><a href="#name">Name</a>: Enter 1 to 63 characters' in page
    send(admin, "/admin/groups", name="crew")
    assert "The name is taken." in send(admin, "/admin/groups", name="crew").text


def test_robot_is_moved_from_its_own_page(admin, database):
    """Its page, the search and the site's pages follow; a robot that is not at a site cannot be removed from it."""

    def site_of_sim1():
        with database.transaction() as tx:
            return robots.get(tx, "sim1").site

    assert "There is no site yet" in admin.ask("GET", "/admin/robots/sim1").text
    send(admin, "/admin/sites", name="lab")
    assert send(admin, "/admin/robots/sim1/site", site="lab").location == "/admin/robots/sim1"
    assert site_of_sim1() == "lab"
    assert "/admin/sites/lab" in admin.ask("GET", "/admin/robots?q=lab").text
    send(admin, "/admin/robots/sim1/site", site="")
    assert site_of_sim1() is None
    answer = send(admin, "/admin/sites/lab/robots/sim1/take-out")
    assert (answer.status_code, "it is not there" in answer.text) == (409, True)
    assert send(admin, "/admin/sites/lab/robots/ghost/take-out").status_code == 404


@pytest.mark.parametrize(
    ("kind", "place"), [("group", "given to no group"), ("site", "at no site")]
)
def test_question_names_the_join_tokens_that_lose_the_record(admin, database, kind, place):
    """Only tokens that can still admit a robot are named."""
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

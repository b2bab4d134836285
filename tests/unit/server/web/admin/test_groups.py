"""The pages of groups."""

from __future__ import annotations

from admin_visitor import send
from robotether_server.db import Database, grants
from web_visitor import Browser, audit_kinds


def members(database: Database) -> tuple[str, ...]:
    """Who is in the crew."""
    with database.transaction() as tx:
        return grants.get_group(tx, "crew").members


def test_group_is_added_filled_and_removed(admin: Browser, database: Database) -> None:
    """Each with its page, its question and its line in the log."""
    assert "There is no group yet" in admin.ask("GET", "/admin/groups").text
    assert send(admin, "/admin/groups", name="crew").location == "/admin/groups/crew"
    assert "It has no members yet" in admin.ask("GET", "/admin/groups/crew").text
    assert send(admin, "/admin/groups/crew/members", user="ann").location == "/admin/groups/crew"
    assert members(database) == ("ann",)
    assert "/admin/groups/crew" in admin.ask("GET", "/admin/users/ann").text
    path = "/admin/groups/crew/members/ann/remove"
    assert "Add ann again" in admin.ask("GET", path).text
    assert send(admin, path).location == "/admin/groups/crew"
    assert members(database) == ()
    send(admin, "/admin/groups/crew/members", user="ann")
    assert "Members: ann." in admin.ask("GET", "/admin/groups/crew/remove").text
    send(admin, path)
    assert "Remove group crew?" in admin.ask("GET", "/admin/groups/crew/remove").text
    assert send(admin, "/admin/groups/crew/remove").location == "/admin/groups"
    assert [kind for kind, *_ in audit_kinds(database)][-6:] == [
        "group_added",
        *["group_member_added", "group_member_removed"] * 2,
        "group_removed",
    ]


def test_wrong_field_is_marked(admin: Browser) -> None:
    """What to enter stands at its label, the focus is there, and the summary leads to it."""
    page = send(admin, "/admin/groups", name="The Crew").text
    assert 'aria-invalid="true" autofocus aria-describedby="name-problem name-hint"' in page
    assert '<p class="wrong" id="name-problem">Enter 1 to 63 characters' in page
    assert '<p><a href="#name">Name</a>: Enter 1 to 63 characters' in page
    send(admin, "/admin/groups", name="crew")
    assert "The name is taken." in send(admin, "/admin/groups", name="crew").text

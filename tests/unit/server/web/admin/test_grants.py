"""Grants from a robot's page and from a user's."""

from __future__ import annotations

import pytest
from admin_visitor import send
from robotether_server.administration import grants
from robotether_server.store import Database
from web_visitor import Browser, audit_kinds

PAGES = ("/admin/robots/sim2", "/admin/users/ann")


def all_grants(database: Database) -> set[tuple[str, str, str]]:
    """Every grant as user, robot, level."""
    with database.transaction() as tx:
        return {(one.user, one.robot, one.level) for one in grants.list_all(tx)}


@pytest.mark.parametrize("page", PAGES)
def test_a_grant_is_given_and_changed(admin: Browser, database: Database, page: str) -> None:
    """And the page that the form stands on follows."""
    for level in ("observe", "manage"):
        answer = send(admin, f"{page}/grants", user="ann", robot="sim2", level=level)
        assert (answer.status_code, answer.location) == (303, page)
        assert ("ann", "sim2", level) in all_grants(database)
    assert audit_kinds(database)[-1] == ("grant_given", "root", "198.51.100.7")


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize(
    "wrong", [{"user": "ghost"}, {"robot": "ghost"}, {"level": "own"}, {"user": ""}]
)
def test_a_wrong_grant_comes_back_with_the_page(
    admin: Browser, database: Database, page: str, wrong: dict[str, str]
) -> None:
    """And the sentence; nothing is given."""
    before = all_grants(database)
    form = {"user": "ann", "robot": "sim2", "level": "drive"} | wrong
    answer = send(admin, f"{page}/grants", **form)
    assert (answer.status_code >= 400, "form-problem" in answer.text) == (True, True)
    assert all_grants(database) == before


@pytest.mark.parametrize(
    ("about", "onward"), [("robot", "/admin/robots/sim1"), ("user", "/admin/users/ann")]
)
def test_a_grant_is_taken_away_after_a_question(
    admin: Browser, database: Database, about: str, onward: str
) -> None:
    """It leads back to where it began."""
    path = f"/admin/grants/ann/sim1/take?from={about}"
    assert "who may drive it now" in admin.ask("GET", path).text
    assert ("ann", "sim1", "drive") in all_grants(database)
    assert send(admin, path).location == onward
    assert ("ann", "sim1", "drive") not in all_grants(database)


def test_a_grant_that_is_not_there_cannot_be_taken(admin: Browser) -> None:
    """404."""
    assert admin.ask("GET", "/admin/grants/ann/sim2/take").status_code == 404

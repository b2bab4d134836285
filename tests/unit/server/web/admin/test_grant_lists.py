"""Which grants a page shows, and what its form offers."""

from __future__ import annotations

import pytest
from flask import Flask
from robotether_server.db import Database, robots, users
from robotether_server.db.audit import Source
from robotether_server.services import grants
from robotether_server.services.grants import ALL, Grantee, Scope
from robotether_server.web.admin import grant_lists

ADMIN = Source("root")
CREW, ANN, OLGA = Grantee("group", "crew"), Grantee("user", "ann"), Grantee("user", "olga")


@pytest.fixture
def _given(app: Flask, database: Database) -> None:
    """One grant of each kind, beside ann's and olga's for sim1."""
    assert app
    with database.transaction() as tx:
        grants.add_group(tx, ADMIN, "crew")
        grants.add_member(tx, ADMIN, "crew", "ann")
        grants.add_site(tx, ADMIN, "lab")
        grants.place_robot(tx, ADMIN, "sim2", "lab")
        grants.give(tx, ADMIN, CREW, Scope("site", "lab"), "manage")
        grants.give(tx, ADMIN, OLGA, ALL, "observe")


@pytest.mark.usefixtures("_given")
def test_page_shows_all_that_reach_its_subject(database: Database) -> None:
    """Also by way of group, site and all."""
    with database.transaction() as tx:
        lists = {
            "sim1": grant_lists.for_robot(tx, robots.get(tx, "sim1")),
            "sim2": grant_lists.for_robot(tx, robots.get(tx, "sim2")),
            "lab": grant_lists.for_site(tx, "lab"),
            "ann": grant_lists.of_user(tx, users.get(tx, "ann")),
            "crew": grant_lists.of_group(tx, "crew"),
        }
    found = {
        name: {(one.holder_words, one.scope_words) for one in given}
        for name, given in lists.items()
    }
    everything = ("user olga", "all robots")
    lab = ("group crew", "site lab")
    assert found == {
        "sim1": {("user ann", "robot sim1"), ("user olga", "robot sim1"), everything},
        "sim2": {lab, everything},
        "lab": {lab, everything},
        "ann": {("user ann", "robot sim1"), lab},
        "crew": {lab},
    }


@pytest.mark.usefixtures("_given")
def test_forms_offer_who_needs_a_grant_and_what_there_is(database: Database) -> None:
    """Admins need none."""
    with database.transaction() as tx:
        holders, scopes = grant_lists.holders(tx), grant_lists.scopes(tx)
    assert [value for _, options in holders for value, _ in options] == [
        "user:ann",
        "user:olga",
        "group:crew",
    ]
    assert [value for _, options in scopes for value, _ in options] == [
        "robot:sim1",
        "robot:sim2",
        "site:lab",
        "all",
    ]

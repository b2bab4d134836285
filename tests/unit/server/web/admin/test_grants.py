"""Grants on the pages of robots, users, groups and sites: which each shows, given and removed."""

import datetime as dt
import re

import pytest
from admin_visitor import send
from robotether_server.db import robots, seen_robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, SITES, get, list_all
from robotether_server.services import grants
from robotether_server.services.grants import ALL, Grantee, Scope
from robotether_server.times import utc_now
from robotether_server.web.admin import grants as grant_pages
from web_visitor import audit_kinds

ADMIN = Source("root")
FORM = {"holder": "user:ann", "scope": "robot:sim2", "level": "drive", "ends_at": ""}
# Each with the page that shows its grants.
PAGES = {
    "/admin/robots/sim2": "/admin/robots/sim2/access",
    "/admin/users/ann": "/admin/users/ann",
    "/admin/groups/crew": "/admin/groups/crew",
    "/admin/sites/lab": "/admin/sites/lab",
}


@pytest.fixture(autouse=True)
def _crew_and_lab(admin, database):
    """A group with ann, and a site with sim2; after the users and robots of `admin`."""
    assert admin
    with database.transaction() as tx:
        GROUPS.add(tx, "crew")
        grants.add_member(tx, ADMIN, "crew", "ann")
        SITES.add(tx, "lab")
        grants.place_robot(tx, ADMIN, "sim2", "lab")


def all_grants(database):
    with database.transaction() as tx:
        found = list_all(tx)
    return {(item.holder_words, item.scope_words, item.level) for item in found}


def number_of(database, who, what):
    with database.transaction() as tx:
        numbers = {(item.holder_words, item.scope_words): item.id for item in list_all(tx)}
    return numbers[who, what]


def test_a_grant_has_ended_by_the_clock_of_the_database(database):
    ends_at = utc_now() + dt.timedelta(hours=1)
    with database.transaction() as tx:
        number = grants.give(tx, ADMIN, Grantee("user", "olga"), ALL, "observe", ends_at=ends_at)[
            0
        ].id
        for later_s, has_ended in ((0, False), (7200, True)):
            tx.change("SET timestamp = UNIX_TIMESTAMP() + %s", (later_s,))
            assert get(tx, number).has_ended == has_ended


@pytest.fixture
def every_kind(database):
    """The crew manages the lab, and olga observes all, beside ann's and olga's grants for sim1."""
    with database.transaction() as tx:
        grants.give(tx, ADMIN, Grantee("group", "crew"), Scope("site", "lab"), "manage")
        grants.give(tx, ADMIN, Grantee("user", "olga"), ALL, "observe")


@pytest.mark.usefixtures("every_kind")
def test_page_shows_all_that_reach_its_subject(database):
    with database.transaction() as tx:
        lists = {
            "sim1": grant_pages.for_robot(tx, robots.get(tx, "sim1")),
            "sim2": grant_pages.for_robot(tx, robots.get(tx, "sim2")),
            "lab": grant_pages.for_site(tx, "lab"),
            "ann": grant_pages.of_user(tx, users.get(tx, "ann")),
            "crew": grant_pages.of_group(tx, "crew"),
        }
    found = {
        name: {(item.holder_words, item.scope_words) for item in given}
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


def test_a_grant_is_given_and_changed(admin, database):
    for page, shown in PAGES.items():
        for level in ("observe", "manage"):
            answer = send(admin, f"{page}/grants", **(FORM | {"level": level}))
            assert (answer.status_code, answer.location) == (303, shown)
            assert ("user ann", "robot sim2", level) in all_grants(database)
    assert audit_kinds(database)[-1] == ("grant_given", "root", "198.51.100.7")
    page = admin.ask("GET", "/admin/users/ann").text + admin.ask("GET", "/admin/sites/lab").text
    for holder, scope, given in (
        ("group:crew", "site:lab", ("group crew", "site lab", "drive")),
        ("user:ann", "all", ("user ann", "all robots", "drive")),
    ):
        assert (f'value="{holder}"' in page, f'value="{scope}"' in page) == (True, True)
        send(admin, "/admin/users/ann/grants", **(FORM | {"holder": holder, "scope": scope}))
        assert given in all_grants(database)


def test_a_row_does_not_undo_what_another_admin_did(admin, database):
    number = number_of(database, "user ann", "robot sim1")
    row = FORM | {"scope": "robot:sim1", "grant": str(number), "was": "drive "}
    assert 'name="was" value="drive "' in admin.ask("GET", "/admin/users/ann").text
    assert send(admin, "/admin/users/ann/grants", **row | {"level": "observe"}).status_code == 303
    answer = send(admin, "/admin/users/ann/grants", **row | {"ends_at": "2099-01-01T12:00"})
    assert (answer.status_code, "somebody else has changed it" in answer.text) == (409, True)
    assert ("user ann", "robot sim1", "observe") in all_grants(database)


def test_a_wrong_grant_comes_back_with_the_page(admin, database):
    before = all_grants(database)
    for wrong in (
        {"holder": "user:ghost"},
        {"holder": "ann"},
        {"scope": "all:x"},
        {"ends_at": "2020-01-01T12:00"},
        {"ends_at": "soon"},
    ):
        answer = send(admin, "/admin/users/ann/grants", **(FORM | wrong))
        assert (answer.status_code >= 400, "form-problem" in answer.text) == (True, True), wrong
    assert all_grants(database) == before


@pytest.mark.usefixtures("every_kind")
@pytest.mark.parametrize(
    ("who", "what", "level", "about", "onward"),
    [
        ("user ann", "robot sim1", "drive", "robot", "/admin/robots/sim1/access"),
        ("group crew", "site lab", "manage", "site", "/admin/sites/lab"),
    ],
)
def test_a_grant_is_taken_away_after_a_question(
    *, admin, database, who, what, level, about, onward
):
    path = f"/admin/grants/{number_of(database, who, what)}/take?from={about}"
    assert f"who may {level} now" in admin.ask("GET", path).text
    assert (who, what, level) in all_grants(database)
    assert send(admin, path).location == onward
    assert (who, what, level) not in all_grants(database)


def test_a_page_from_before_changes_no_robot_that_has_got_the_name(admin, database):
    """Neither what was chosen there nor the answer to a question."""
    question = "/admin/sites/lab/robots/sim2/take-out"
    [scope], [robot], [taken], [ticked] = (
        re.findall(pattern, admin.ask("GET", path).text)
        for path, pattern in (
            ("/admin/users/ann", 'value="(robot:sim2 [^"]+)"'),
            ("/admin/sites/lab", 'value="(sim1 [^"]+)"'),
            (question, '"meant" value="(.+)"'),
            ("/admin/robots", 'value="(.+)" aria-label="Select sim1"'),
        )
    )
    with database.transaction() as tx:
        for was, name in (("sim1", "x"), ("sim2", "sim1"), ("x", "sim2")):
            tx.change("UPDATE robots SET name = %s WHERE name = %s", (name, was))
    before = all_grants(database), audit_kinds(database)
    number = number_of(database, "user ann", "robot sim2")
    for path, form in (
        ("/admin/users/ann/grants", FORM | {"scope": scope}),
        ("/admin/users/ann/grants", FORM | {"scope": "robot:sim1", "grant": str(number)}),
        ("/admin/sites/lab/robots", {"robot": robot}),
        (question, {"meant": taken}),
    ):
        assert send(admin, path, **form).status_code == 404, path
    assert (all_grants(database), audit_kinds(database)) == before
    page = admin.ask("GET", "/admin/selected-robots/disable", query_string={"robot": ticked}).text
    assert "<li>sim2</li>" in page
    send(admin, "/admin/selected-robots/disable", robots=ticked)
    with database.transaction() as tx:
        states = {seen.robot.name: seen.robot.state for seen in seen_robots.list_all(tx)}
    assert [name for name, state in states.items() if state == "disabled"] == ["sim2"]

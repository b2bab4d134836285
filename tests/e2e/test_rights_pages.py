"""An admin in a real browser gives rights by group and site, sets safety and permissions, and reads what was driven."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from http import HTTPStatus

import pytest
from pages import log_in
from playwright.sync_api import Page, expect
from stack import Stack


def _done(page: Page, message: str) -> None:
    expect(page.get_by_test_id("done")).to_have_text(message)


@pytest.fixture
def password(stack: Stack) -> Iterator[str]:
    """That of ida, a user of these tests; afterwards user, group and site are gone."""
    yield stack.admin.add_user("ida")
    for kind, name in (("users", "ida"), ("groups", "e2e-crew"), ("sites", "e2e-lab")):
        # A test that failed early has not made all of them.
        status, answer = stack.admin.try_to("DELETE", f"/{kind}/{name}")
        assert status in {HTTPStatus.NO_CONTENT, HTTPStatus.NOT_FOUND}, answer


@pytest.fixture
def defaults(stack: Stack) -> Iterator[None]:
    """The settings of sim3 are the defaults, whatever other tests set; and afterwards, also for the relay."""
    stack.admin.ask("PATCH", "/robots/sim3", {"settings": {}})
    yield
    stack.admin.ask("PATCH", "/robots/sim3", {"settings": {}})
    # It ends connections of before such a change, which may be those of the next test.
    stack.wait_for_changes("sim3")


def test_member_of_a_group_sees_the_robots_of_a_site(
    page: Page, stack: Stack, password: str
) -> None:
    page.goto(f"{stack.url}/admin/groups")
    page.get_by_label("Name").fill("e2e-crew")
    page.get_by_test_id("group-add").click()
    page.get_by_label("User", exact=True).select_option("ida")
    page.get_by_test_id("member-add").click()
    _done(page, "User ida is a member of group e2e-crew.")
    page.goto(f"{stack.url}/admin/sites")
    page.get_by_label("Name").fill("e2e-lab")
    page.get_by_test_id("site-add").click()
    page.get_by_label("Who", exact=True).select_option("group:e2e-crew")
    page.get_by_label("May", exact=True).select_option("observe")
    page.get_by_test_id("grant-submit").click()
    _done(page, "Group e2e-crew may observe site e2e-lab.")
    browser = page.context.browser
    assert browser is not None
    with closing(browser.new_context(ignore_https_errors=True)) as context:
        ida = context.new_page()
        log_in(ida, stack, "ida", password)
        expect(ida.get_by_test_id("fleet-empty")).to_be_visible()
        page.goto(f"{stack.url}/admin/robots/sim3")
        page.get_by_label("Robot's site").select_option("e2e-lab")
        page.get_by_test_id("site-save").click()
        _done(page, "Robot sim3 is at site e2e-lab.")
        expect(ida.get_by_test_id("robot-card-sim3")).to_be_visible(timeout=10_000)
        page.goto(f"{stack.url}/admin/groups/e2e-crew/members/ida/remove")
        page.get_by_test_id("deed-do").click()
        _done(page, "User ida is no longer a member of group e2e-crew.")
        expect(ida.get_by_test_id("robot-card-sim3")).to_have_count(0, timeout=10_000)


@pytest.mark.usefixtures("defaults")
def test_safety_and_permissions_are_set(page: Page, stack: Stack) -> None:
    """What is wrong is said at its field; what is good stands on the robot's page; the defaults come back."""
    robot = f"{stack.url}/admin/robots/sim3"
    page.goto(f"{robot}/settings")
    page.wait_for_url("**/robots/sim3/settings")
    speed, steering = (
        page.get_by_label("Robot's limit (m/s)"),
        page.get_by_label("Maximum steering"),
    )
    page.get_by_test_id("more").locator("summary").click()
    steering.fill("far")
    page.get_by_test_id("settings-save").click()
    expect(steering).to_be_focused()
    expect(steering).to_have_attribute("aria-invalid", "true")
    page.get_by_test_id("form-problem").get_by_role("link", name="Maximum steering").click()
    steering.fill("")
    speed.fill("0,75")
    page.get_by_test_id("settings-save").click()
    _done(page, "The safety settings of robot sim3 are saved.")
    page.get_by_test_id("tab-permissions").click()
    page.get_by_label("Call").first.fill("/arm/*\n/lamp")
    page.get_by_test_id("settings-save").click()
    _done(page, "The permissions of robot sim3 are saved.")
    page.get_by_test_id("admin-page").click()
    expect(page.get_by_test_id("settings")).to_contain_text("0.75")
    expect(page.get_by_test_id("settings")).to_contain_text("/arm/*, /lamp")
    kept = json.loads(stack.sql("SELECT settings FROM robots WHERE name = 'sim3'")[0][0])
    assert kept == {
        "guard": {"max_speed_m_s": 0.75},
        "policy": {"drive": {"call": ["/arm/*", "/lamp"]}},
    }
    page.get_by_test_id("tab-settings").click()
    page.get_by_test_id("defaults").click()
    page.get_by_test_id("deed-do").click()
    page.get_by_test_id("admin-page").click()
    expect(page.get_by_test_id("robot-name")).to_have_text("sim3")
    expect(page.get_by_test_id("settings")).to_have_count(0)

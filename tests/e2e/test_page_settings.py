"""A manager who is no admin sets a robot's drive page in a real browser, while somebody drives it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

import pytest
from pages import be_logged_in, drive_live
from playwright.sync_api import Browser, Page, expect
from stack import Stack

ROBOT = "sim3"
SETTINGS = f"/robots/{ROBOT}/settings"


@pytest.fixture
def people(stack: Stack) -> Iterator[dict[str, str]]:
    """Passwords of mia, who manages sim3, and dan, who drives it."""
    admin = stack.admin
    stack.wait_until_drivable(ROBOT)
    found: dict[str, str] = {}
    try:
        for name in ("mia", "dan"):
            found[name] = admin.add_user(name)
        admin.grant("mia", ROBOT, "manage")
        admin.grant("dan", ROBOT, "drive")
        for name in found:
            stack.wait_for_right(name, ROBOT)
        yield found
    finally:
        for name in found:
            admin.remove("users", name)
        admin.set_robot(ROBOT, {"page": None})
        stack.wait_for_changes(ROBOT)


@contextmanager
def _opened(browser: Browser, stack: Stack, name: str, password: str) -> Iterator[Page]:
    """A browser of this person's own, logged in; no page of it may raise an error."""
    context = browser.new_context(ignore_https_errors=True)
    errors: list[str] = []
    try:
        be_logged_in(context, stack, name, password)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page
    finally:
        context.close()
    assert errors == []


def _settings(page: Page) -> dict[str, Any]:
    """What the drive page is told."""
    return dict(json.loads(page.locator("main").get_attribute("data-settings") or ""))


def _control(stack: Stack, robot: str, token: str) -> dict[str, Any] | None:
    """What the relay says of a robot; None: it may not say it."""
    bearer = {"Authorization": f"Bearer {token}"}
    status, control = stack.request("GET", f"/api/v1/robots/{robot}/control", headers=bearer)
    return control if status == HTTPStatus.OK else None


def _wait_until_relay_has_read(stack: Stack) -> None:
    """Wait until the relay knows what the database holds now: a right that is given last shows it."""
    token = stack.token("news", user="dan")
    assert _control(stack, "sim1", token) is None
    stack.admin.grant("dan", "sim1", "observe")
    stack.wait("the relay knows a new grant", lambda: _control(stack, "sim1", token), "relay")


def test_the_page_of_a_robot_is_set_while_somebody_drives_it(
    browser: Browser, stack: Stack, people: dict[str, str]
) -> None:
    """The drive goes on with the page that is open; whoever opens it then gets the new one."""
    with (
        _opened(browser, stack, "dan", people["dan"]) as dan,
        _opened(browser, stack, "mia", people["mia"]) as mia,
    ):
        drive_live(dan, stack, ROBOT)
        mia.goto(f"{stack.url}{SETTINGS}")
        mia.get_by_label("Topic of camera 1").fill("/rear/image_raw")
        mia.get_by_label("Name", exact=True).first.fill("Rear")
        mia.get_by_label("Turned by").first.select_option("180")
        mia.get_by_label("Highest quality").fill("10")
        mia.get_by_test_id("page-save").click()
        expect(mia.get_by_test_id("form-problem")).to_contain_text(
            "is over the highest quality, 10"
        )
        mia.get_by_label("Highest quality").fill("60")
        mia.get_by_test_id("page-save").click()
        expect(mia.get_by_test_id("done")).to_contain_text(
            f"The cameras of robot {ROBOT} are saved."
        )
        mia.get_by_test_id("tab-driving").click()
        mia.get_by_label("How it moves").select_option("holonomic")
        mia.get_by_label("Stop driving when the video freezes").uncheck()
        mia.get_by_test_id("page-save").click()
        expect(mia.get_by_test_id("done")).to_contain_text("The driving settings of robot")
        expect(mia.get_by_label("Stop driving when the video freezes")).not_to_be_checked()
        _wait_until_relay_has_read(stack)
        assert _control(stack, ROBOT, stack.token("page"))["driver"]["user"] == "dan"
        expect(dan.get_by_test_id("state")).to_have_attribute("data-state", "live")
        assert _settings(dan)["page"]["kind"] == "differential"
        dan.reload()
        page = _settings(dan)["page"]
    camera = {"topic": "/rear/image_raw", "name": "Rear", "turned_deg": 180}
    assert (page["kind"], page["cameras"]) == ("holonomic", [camera])
    assert (page["hold_after_ms"], page["quality_max"]) == (None, 60)

"""A manager who is not an admin sets a robot's drive page in a real browser, while somebody drives it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from page_users import PageUsers
from playwright.sync_api import Browser, Page, expect
from stack import Stack

ROBOT = "sim3"


@pytest.fixture
def page_users(stack: Stack, browser: Browser) -> Iterator[PageUsers]:
    """Mia, who manages sim3, and Dan, who drives it."""
    stack.wait_until_drivable(ROBOT)
    try:
        with closing(PageUsers(stack, browser)) as people:
            people.let("mia", "manage", ROBOT)
            people.let("dan", "drive", ROBOT)
            yield people
    finally:
        stack.admin.set_robot(ROBOT, {"page": None})
        stack.wait_for_changes(ROBOT)


def _settings(page: Page) -> dict[str, Any]:
    """What the drive page is told."""
    return dict(json.loads(page.locator("main").get_attribute("data-settings") or ""))


def test_the_page_of_a_robot_is_set_while_somebody_drives_it(
    page_users: PageUsers, stack: Stack
) -> None:
    """The drive goes on with the page that is open; whoever opens it then gets the new one."""
    dan, mia = page_users.drive("dan", ROBOT), page_users.browse("mia")
    mia.goto(f"{stack.url}/robots/{ROBOT}/settings")
    mia.get_by_label("Topic of camera 1").fill("/rear/image_raw")
    mia.get_by_label("Name", exact=True).first.fill("Rear")
    mia.get_by_label("Turned by").first.select_option("180")
    mia.get_by_label("Highest quality").fill("10")
    mia.get_by_test_id("page-save").click()
    expect(mia.get_by_test_id("form-problem")).to_contain_text("is over the highest quality, 10")
    mia.get_by_label("Highest quality").fill("60")
    mia.get_by_test_id("page-save").click()
    expect(mia.get_by_test_id("done")).to_contain_text(f"The cameras of robot {ROBOT} are saved.")
    mia.get_by_test_id("tab-driving").click()
    mia.get_by_label("How it moves").select_option("holonomic")
    mia.get_by_label("Stop driving when the video freezes").uncheck()
    mia.get_by_test_id("page-save").click()
    expect(mia.get_by_test_id("done")).to_contain_text("The driving settings of robot")
    expect(mia.get_by_label("Stop driving when the video freezes")).not_to_be_checked()
    stack.wait_for_changes(ROBOT)
    assert stack.admin.ask("GET", f"/robots/{ROBOT}/control")["driver"]["user"] == "dan"
    expect(dan.get_by_test_id("state")).to_have_attribute("data-state", "live")
    assert _settings(dan)["page"]["kind"] == "differential"
    dan.reload()
    page = _settings(dan)["page"]
    camera = {"topic": "/rear/image_raw", "name": "Rear", "turned_deg": 180}
    assert (page["kind"], page["cameras"]) == ("holonomic", [camera])
    assert (page["hold_after_ms"], page["quality_max"]) == (None, 60)

"""axe-core finds nothing on fleet and drive page in their states; test_every_page.py looks at each page once."""

import page_holds
import pytest
from accessibility import BY_LOOK, RULES, violations
from page_users import release_all
from pages import open_drawer, open_page, open_robot, take_control
from playwright.sync_api import expect
from sim_service import frozen_cameras

ROBOT = "sim1"
DESKTOP = {"viewport": {"width": 1280, "height": 800}, "color_scheme": "light"}
PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "color_scheme": "dark"}
# Dark on a phone takes as long again, and finds what a release changed in the styles.
BOTH = pytest.mark.parametrize(
    "context",
    [
        pytest.param(DESKTOP, id="desktop"),
        pytest.param(PHONE, id="phone", marks=pytest.mark.release),
    ],
    indirect=True,
)


def _assert_accessible(page, what):
    """By all rules as the page is, and in the other colour scheme by those that this may break."""
    found = violations(page, RULES)
    is_dark = page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches")
    page.emulate_media(color_scheme="light" if is_dark else "dark")
    found += violations(page, BY_LOOK)
    page.emulate_media(color_scheme="dark" if is_dark else "light")
    assert found == [], f"{what}: {found}"


@BOTH
def test_fleet_and_drive_page_are_accessible(page, stack):
    open_page(page, stack, "/")
    for view in ("table", "cards"):
        page.get_by_test_id(f"view-{view}").click()
        _assert_accessible(page, f"the fleet as {view}")
    stack.wait_until_drivable(ROBOT)
    open_robot(page, stack, ROBOT)
    take_control(page)
    open_drawer(page)
    for opener in ("gamepad-open", "topics", "uplink"):
        fold = page.get_by_test_id(opener)
        (fold if opener == "gamepad-open" else fold.locator("summary")).click()
    # By key: on a phone it comes to lie where the press before was, which takes a second one for a double press.
    page.get_by_test_id("topic-list").get_by_role("button", name="/odom").first.press("Enter")
    page.get_by_test_id("topic-close").evaluate("e => e.scrollIntoView({block: 'center'})")
    _assert_accessible(page, "the drive page with gamepad and topics unfolded")
    page.get_by_test_id("drawer-open").click()
    with frozen_cameras(stack, ROBOT):
        expect(page.get_by_test_id("state")).to_have_attribute("data-shown", "held")
        _assert_accessible(page, "the drive page while driving is held")
    try:
        page.get_by_test_id("stop").click()
        bar = page.get_by_test_id("stop-bar")
        expect(bar).to_have_attribute("data-stop", "stopped")
        _assert_accessible(page, "the drive page of a stopped robot")
        page_holds.release_stop(page)
    finally:
        release_all(stack, [ROBOT])

"""What the page says is true: how old the video is, and which state keeps the robot from driving, and what to do.

Which state comes before which, and its words, are unit tests of controlPanel.js.
"""

import re
import time

import page_holds
from page_users import PageUsers
from pages import drive_live, expect_armed, log_in
from playwright.sync_api import expect
from sim_service import frozen_cameras
from sim_watch import SimWatch

ROBOT = "sim1"
ZERO = {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
FRONT = "[data-testid=tile][data-topic='/camera/image_raw']"


def _expect_shown(page, name, words, seconds=10):
    """Wait for a state of the banner, and for what it says."""
    state = page.get_by_test_id("state")
    expect(state).to_have_attribute("data-shown", name, timeout=seconds * 1000)
    expect(state).to_contain_text(words)


def _assert_still(page, watch):
    """A key that is still down repeats, and nothing but zero comes to the wheels."""
    since = time.monotonic()
    page.keyboard.down("w")
    time.sleep(0.5)  # in which a command would have come
    assert [seen.msg for seen in watch.commands(since) if seen.msg != ZERO] == []


def _press_drive_without_video(page):
    """A late frame may end the pause once more, and a button that comes back takes no press at first."""
    old = re.compile(r"^([2-9]|[1-9]\d)\d{3} ms$")
    expect(page.get_by_test_id("picture-age")).to_have_text(old)
    action = page.get_by_test_id("state-action")
    expect(action).to_be_enabled()
    action.press("Enter")


def test_a_frozen_video_holds_driving_until_pressed_anew_or_allowed(page, stack, browser):
    """It is grey with its age, a warning in the diagnostics, and holds nobody who watches."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    page_users = PageUsers(stack, browser)
    page_users.let("olga", "observe", ROBOT)
    try:
        watching = page_users.open("olga", ROBOT)
        expect(page.get_by_test_id("watchers")).to_have_text("1 watching.")
        page.bring_to_front()
        diagnostics, age = page.get_by_test_id("diagnostics"), page.get_by_test_id("picture-age")
        with SimWatch(stack, ROBOT) as watch:
            page_holds.drive(page, watch)
            with frozen_cameras(stack, ROBOT):
                _expect_shown(page, "held", "The video is frozen.")
                watch.wait_standing()
                expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
                _assert_still(page, watch)
                tile = page.locator(FRONT)
                expect(tile).to_have_attribute("data-frame", "old")
                expect(tile.get_by_test_id("tile-words")).to_contain_text("This video is old.")
                filters = page.get_by_test_id("video").evaluate("e => getComputedStyle(e).filter")
                assert "grayscale" in filters
                expect(age).to_have_text(re.compile(r"^[1-9]\d{3,} ms$"))
                expect(age).to_have_attribute("data-health", "poor")
                expect(diagnostics).to_have_attribute("data-level", "warn")
                _expect_shown(watching, "live", "You are watching.")
            _expect_shown(page, "live", "Ready to drive.")
            expect(tile.get_by_test_id("tile-words")).to_be_empty()
            expect(diagnostics).to_have_attribute("data-level", "ok")
            _assert_still(page, watch)
            page.keyboard.up("w")
            with frozen_cameras(stack, ROBOT):
                _expect_shown(page, "held", "Paused")
                _press_drive_without_video(page)
                _expect_shown(page, "blind", "You cannot see")
                expect(page.get_by_test_id("state")).to_be_focused()
                page_holds.drive(page, watch)
                # What is unknown has the slowest speed.
                expect(page.get_by_test_id("seen-age")).to_contain_text("seen ? ms ago")
                page.keyboard.up("w")
            _expect_shown(page, "live", "Ready to drive.")
            with frozen_cameras(stack, ROBOT):
                _expect_shown(page, "held", "Paused")
    finally:
        page_users.close()


def test_who_is_logged_out_reads_that_and_nothing_else(page, stack):
    """No page goes on saying that it drives, or that the server does not answer."""
    # A login of this page's own: the others go on.
    page.context.clear_cookies()
    log_in(page, stack)
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    expect_armed(page)
    log_out = page.context.new_page()
    log_out.goto(f"{stack.url}/profile")
    log_out.get_by_test_id("logout").click()
    # A page that is closed on its way to another may never be gone, and close() waits for ever (Playwright #42366).
    log_out.wait_for_url("**/login*")
    log_out.close()
    _expect_shown(page, "not_allowed", "Your login has ended. Log in again.", seconds=15)
    expect(page.get_by_test_id("tile-words")).to_contain_text("Your login has ended.")
    expect(page.get_by_test_id("control")).to_be_hidden()
    shown = page.locator("body").inner_text()
    for word in ("You are driving", "is driving (since", "does not answer"):
        assert word not in shown

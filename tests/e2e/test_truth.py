"""What the page says is true: how old the video is, and which state keeps the robot from driving, and what to do.

A real browser before the whole stack; cameras freeze, networks go and robots lose their power.
"""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import page_holds
import processes
import pytest
from page_users import PageUsers, release_all
from pages import drive_live, expect_armed, expect_live, log_in
from playwright.sync_api import Browser, Page, expect
from sim_service import frozen_cameras
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim1"
ZERO = {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
# From the page's word that driving is held to a zero at the robot: 0.1 s is the page's own part.
HELD_WITHIN_S = 0.5
HOLD_AFTER_MS = 1000
# Notes by the clock of the machine, which is the test's too, when the banner first shows each state.
NOTE_STATES = """() => {
  const state = document.querySelector('[data-testid=state]');
  window.shownAt = {};
  new MutationObserver(() => (window.shownAt[state.dataset.shown] ??= Date.now() / 1000))
    .observe(state, {attributes: true, attributeFilter: ['data-shown']});
}"""


@pytest.fixture(autouse=True)
def _drivable(stack: Stack) -> None:
    """The robots are there, and nobody else drives them, or the page would only watch."""
    for name in ("sim1", "sim2"):
        stack.wait_until_drivable(name)


def _expect_shown(page: Page, name: str, words: str, seconds: float = 10) -> None:
    """Wait for a state of the banner, and for what it says."""
    state = page.get_by_test_id("state")
    expect(state).to_have_attribute("data-shown", name, timeout=seconds * 1000)
    expect(state).to_contain_text(words)


def _assert_still(watch: SimWatch, since: float, seconds: float = 1.0) -> None:
    """Nothing but zero comes to the wheels."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        moved = [seen.msg for seen in watch.commands(since) if seen.msg != ZERO]
        assert moved == [], f"the robot was driven: {moved[:3]}"
        time.sleep(0.05)


def _number(page: Page, name: str) -> float:
    """A reading of the page, once it is there."""
    reading = page.get_by_test_id(name)
    expect(reading).to_contain_text(re.compile(r"\d"), timeout=10_000)
    found = re.search(r"\d+", reading.inner_text())
    assert found is not None
    return float(found[0])


def test_a_frozen_picture_holds_driving_until_pressed_anew(page: Page, stack: Stack) -> None:
    """W held while the camera freezes: the robot stands, and W drives again only after a new press."""
    drive_live(page, stack, ROBOT)
    page.evaluate(NOTE_STATES)
    with SimWatch(stack, ROBOT) as watch:
        page_holds.drive(page, watch)
        with frozen_cameras(stack, ROBOT):
            _expect_shown(page, "held", "The video is frozen.", seconds=5)
            expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
            watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
            held_at = page.evaluate("window.shownAt.held") - time.time() + time.monotonic()
            late = [seen for seen in watch.commands(held_at + HELD_WITHIN_S) if seen.msg != ZERO]
            assert late == [], "driven on after the page held driving"
            page.keyboard.down("w")  # of a key that is down, a repeat
            _assert_still(watch, held_at + HELD_WITHIN_S)
            assert _number(page, "picture-age") > HOLD_AFTER_MS
        _expect_shown(page, "live", "Ready to drive.", seconds=10)
        back_at = time.monotonic()
        page.keyboard.down("w")
        _assert_still(watch, back_at)
        page.keyboard.up("w")
        page_holds.drive(page, watch)
        page.keyboard.up("w")


def test_a_driver_may_go_on_without_the_picture_until_it_is_back(page: Page, stack: Stack) -> None:
    """The button lets driving go on, once: with the next picture the hold is back in force."""
    drive_live(page, stack, ROBOT)
    with SimWatch(stack, ROBOT) as watch:
        with frozen_cameras(stack, ROBOT):
            _expect_shown(page, "held", "Paused", seconds=5)
            page.get_by_test_id("state-action").focus()
            page.keyboard.press("Enter")
            _expect_shown(page, "blind", "You cannot see")
            expect(page.get_by_test_id("state")).to_be_focused()
            page_holds.drive(page, watch)
            page.keyboard.up("w")
        _expect_shown(page, "live", "Ready to drive.", seconds=10)
        with frozen_cameras(stack, ROBOT):
            _expect_shown(page, "held", "Paused", seconds=5)


def test_a_disabled_robot_is_not_told_to_come_back(page: Page, stack: Stack) -> None:
    """The banner says who switched it off; enabled again, the page is live by itself."""
    drive_live(page, stack, ROBOT)
    stack.admin.ask("PATCH", f"/robots/{ROBOT}", {"state": "disabled"})
    try:
        _expect_shown(page, "disabled", "By an administrator.")
        expect(page.get_by_test_id("state")).not_to_contain_text("by itself")
    finally:
        stack.admin.ask("PATCH", f"/robots/{ROBOT}", {"state": "active"})
        # An agent that was told so asks again within 30 s, and at its start at once.
        stack.container(ROBOT).restart(timeout=5)
    expect_live(page, seconds=60)


def test_who_is_logged_out_reads_that_and_nothing_else(page: Page, stack: Stack) -> None:
    """No page goes on saying that it drives, or that the server does not answer."""
    # A login of this page's own: the others go on.
    page.context.clear_cookies()
    log_in(page, stack)
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
    page.wait_for_timeout(1500)  # in which the video was asked for again, and its words changed
    shown = page.locator("body").inner_text()
    for word in ("You are driving", "is driving (since", "does not answer"):
        assert word not in shown


def test_whoever_watches_is_held_by_nothing(stack: Stack, browser: Browser) -> None:
    """An observer's banner stays, whatever the camera does, and the driver's page counts who watches."""
    page_users = PageUsers(stack, browser)
    page_users.let("olga", "observe", ROBOT)
    try:
        driver = page_users.drive("admin", ROBOT)
        watching = page_users.open("olga", ROBOT)
        expect(driver.get_by_test_id("watchers")).to_have_text("1 watching.", timeout=10_000)
        expect(watching.get_by_test_id("driver")).to_contain_text("admin is driving (since")
        with frozen_cameras(stack, ROBOT):
            _expect_shown(driver, "held", "Paused", seconds=5)
            _expect_shown(watching, "live", "You are watching.")
    finally:
        page_users.close()


def test_the_numbers_tell_how_good_they_are_and_where_the_round_trip_goes(
    page: Page, stack: Stack
) -> None:
    """The picture has its age, each number says how good it is, and the parts of the round trip are told."""
    drive_live(page, stack, ROBOT)
    # Below HOLD_AFTER_MS.
    expect(page.get_by_test_id("picture-age")).to_have_text(re.compile(r"^\d{1,3} ms$"))
    for name in ("picture-age", "rtt", "battery"):
        number = page.get_by_test_id(name)
        expect(number).to_have_attribute("data-health", re.compile("good|fair|poor"))
    parts = page.get_by_test_id("rtt-parts")
    words = re.compile(r"\d+ ms to the server, \d+ ms on to the robot, \d+ ms in its rosbridge")
    expect(parts).to_have_text(words, timeout=15_000)


def test_offline_and_online_again(page: Page, stack: Stack) -> None:
    """Without this machine's network the page says so at once, and comes back; what was held does not drive on."""
    drive_live(page, stack, ROBOT)
    with SimWatch(stack, ROBOT) as watch:
        page_holds.drive(page, watch)
        page.context.set_offline(True)
        state = page.get_by_test_id("state")
        expect(state).to_have_attribute(
            "data-shown", re.compile("link_lost|server_unreachable"), timeout=5_000
        )
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
        _expect_shown(page, "server_unreachable", "Check this device's network", seconds=20)
        page.context.set_offline(False)
        expect_live(page, seconds=20)
        back_at = time.monotonic()
        page.keyboard.down("w")
        _assert_still(watch, back_at)
        page.keyboard.up("w")


@contextmanager
def _frozen_ros(stack: Stack) -> Iterator[None]:
    """While this lasts the robot's rosbridge answers nobody; its agent does."""
    found = processes.with_words(stack.container(ROBOT), "-m sim_robot")
    assert found, f"{ROBOT} runs no simulator"
    for pid in found:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in found:
            os.kill(pid, signal.SIGCONT)


def test_a_rosbridge_that_does_not_answer_is_told(page: Page, stack: Stack) -> None:
    """The robot is online and its rosbridge silent: the page says which, and what to do."""
    drive_live(page, stack, ROBOT)
    with _frozen_ros(stack):
        _expect_shown(page, "rosbridge_down", "Start rosbridge there", seconds=40)
    expect_live(page, seconds=30)


def test_a_stop_is_a_state_of_its_own(page: Page, stack: Stack) -> None:
    """A stopped robot's banner says who stopped it and what to do, until it is released."""
    drive_live(page, stack, ROBOT)
    try:
        page.get_by_test_id("stop").click()
        _expect_shown(page, "stopped", "By admin at")
        expect(page.get_by_test_id("state")).to_contain_text(
            "Hold the button beside Stop to drive again"
        )
        release = page.get_by_test_id("release")
        box = release.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        _expect_shown(page, "live", "Ready to drive.", seconds=10)
        page.mouse.up()
    finally:
        release_all(stack, [ROBOT])


@pytest.mark.parametrize("power", ["lost", "switched off and on"])
def test_a_robot_that_reboots_in_mid_drive_waits_for_a_new_press(
    page: Page, stack: Stack, power: str
) -> None:
    """The page says that the robot is offline, comes back with it, and moves nothing by what was held."""
    drive_live(page, stack, "sim2")
    sim = stack.container("sim2")
    with SimWatch(stack, "sim2") as watch:
        page_holds.drive(page, watch)
    if power == "lost":
        sim.kill()
    else:
        sim.stop(timeout=5)
    try:
        state = page.get_by_test_id("state")
        expect(state).to_have_attribute(
            "data-shown", re.compile("link_lost|offline"), timeout=15_000
        )
        _expect_shown(
            page, "offline", "This page connects by itself when the robot is back.", seconds=20
        )
    finally:
        sim.start()
        stack.wait("sim2 online", lambda: stack.online("sim2"), "sim2", seconds=60)
    expect_live(page, seconds=40)
    with SimWatch(stack, "sim2") as watch:
        page.keyboard.down("w")
        _assert_still(watch, since=0)
        page.keyboard.up("w")
        page_holds.drive(page, watch)
        page.keyboard.up("w")

"""An operator in a real browser drives a simulated robot through the whole stack."""

from __future__ import annotations

import math
import re
import time

import pytest
from page_users import PageUsers
from pages import drive_live, expect_armed, log_in, open_page, open_robot
from playwright.sync_api import Browser, Page, expect
from sim_service import call_sim
from sim_watch import SimWatch
from stack import Stack
from stopwatch import Stopwatch

# Of the machine's time, after which the page's zeros are over.
ZEROS_LAST_S, QUIET_S = 0.5, 0.5


@pytest.fixture(autouse=True)
def _drivable(stack: Stack) -> None:
    """The robots are there, and nobody else drives them, or the page would only watch."""
    for robot in ("sim1", "sim2", "sim3"):
        stack.wait_until_drivable(robot)


def _distance(a: dict[str, float], b: dict[str, float]) -> float:
    return math.hypot(a["x"] - b["x"], a["y"] - b["y"])


def _assert_stops(watch: SimWatch) -> None:
    """Zero comes with the release, the robot stands, and then nothing is published any more."""
    with Stopwatch() as released:
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0, seconds=2)
        assert released.s < 1.0
    last = watch.commands()[-1]
    assert last.msg["linear"]["x"] == 0
    assert last.msg["angular"]["z"] == 0
    with Stopwatch() as stood:
        watch.wait_pose("standing for so long", lambda _: stood.s > ZEROS_LAST_S)
        quiet_since = time.monotonic()
        watch.wait_pose("standing on", lambda _: stood.s > ZEROS_LAST_S + QUIET_S)
    assert watch.commands(since=quiet_since) == []
    assert all(seen.msg["linear"]["x"] == 0 for seen in watch.commands(last.at))


def test_fleet_shows_the_robots_online(page: Page, stack: Stack) -> None:
    """The three simulated robots are there and online after the login, which asks for name and password."""
    page.context.clear_cookies()
    log_in(page, stack)
    for name in ("sim1", "sim2", "sim3"):
        expect(page.get_by_test_id(f"robot-card-{name}")).to_have_attribute(
            "data-online", "true", timeout=10_000
        )


def test_fleet_follows_a_robot_that_goes_and_comes(page: Page, stack: Stack) -> None:
    """A card changes without a reload when its robot is switched off and on."""
    open_page(page, stack, "/")
    card = page.get_by_test_id("robot-card-sim3")
    expect(card).to_have_attribute("data-online", "true", timeout=10_000)
    stack.container("sim3").stop(timeout=5)
    try:
        expect(card).to_have_attribute("data-online", "false", timeout=10_000)
    finally:
        stack.container("sim3").start()
    expect(card).to_have_attribute("data-online", "true", timeout=30_000)


def test_holding_a_key_drives_and_releasing_stops(page: Page, stack: Stack) -> None:
    """The robot moves while the key is down, and stands after it is released."""
    drive_live(page, stack, "sim1")
    # Not at a wall, to which another test may have driven it.
    call_sim(stack, "sim1", "/reset")
    with SimWatch(stack, "sim1") as watch:
        start = dict(watch.pose)
        expect_armed(page)
        page.keyboard.down("w")
        watch.wait_pose("moving", lambda pose: _distance(pose, start) > 0.2)
        expect(page.get_by_test_id("speed-linear")).to_contain_text("m/s")
        page.keyboard.up("w")
        _assert_stops(watch)


def test_joystick_drives_and_release_stops(page: Page, stack: Stack) -> None:
    """Dragging the stick up and left drives forward in a left turn; letting go stops."""
    drive_live(page, stack, "sim1")
    box = page.get_by_test_id("joystick").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    with SimWatch(stack, "sim1") as watch:
        expect_armed(page)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - box["width"] / 6, y - box["height"] / 3, steps=4)
        watch.wait_pose(
            "turning left while moving",
            lambda pose: pose["linear_velocity"] > 0.1 and pose["angular_velocity"] > 0.1,
        )
        page.mouse.up()
        _assert_stops(watch)


LOSSES = {
    "blur": "window.dispatchEvent(new Event('blur'))",
    "hidden": "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
    "Object.defineProperty(document, 'visibilityState', {value: 'hidden', configurable: true});"
    "document.dispatchEvent(new Event('visibilitychange'))",
}


def test_losing_the_page_stops_the_robot(page: Page, stack: Stack) -> None:
    """A key held while the window loses focus or is hidden drives no longer."""
    drive_live(page, stack, "sim1")
    with SimWatch(stack, "sim1") as watch:
        for how, event in LOSSES.items():
            expect_armed(page)
            page.keyboard.down("w")
            watch.wait_pose(f"moving before {how}", lambda pose: pose["linear_velocity"] > 0)
            page.evaluate(event)
            _assert_stops(watch)
            page.keyboard.up("w")


def test_video_shows_the_robots_camera(page: Page, stack: Stack) -> None:
    """The picture is there, with the size of a camera frame."""
    open_robot(page, stack, "sim1")
    page.wait_for_function(
        "() => document.querySelector('[data-frame=live] [data-testid=video]')?.width >= 160",
        timeout=10_000,
    )


def test_page_resumes_by_itself_after_a_cut(page: Page, stack: Stack) -> None:
    """When the robot's tunnel is cut the page says so, comes back without a reload, and drives again."""
    drive_live(page, stack, "sim2")
    page.evaluate("window.sameDocument = true")
    state = page.get_by_test_id("state")
    stack.container("sim2").stop(timeout=5)
    try:
        expect(state).not_to_have_attribute("data-state", "live", timeout=10_000)
    finally:
        stack.container("sim2").start()
    expect(state).to_have_attribute("data-state", "live", timeout=30_000)
    assert page.evaluate("window.sameDocument") is True
    # There is a picture to drive by, too.
    expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "true", timeout=15_000)
    with SimWatch(stack, "sim2") as watch:
        expect_armed(page)
        page.keyboard.down("w")
        watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0)
        expect(page.get_by_test_id("speed-linear")).to_contain_text("m/s")
        page.keyboard.up("w")
        _assert_stops(watch)


def test_observer_sees_and_cannot_drive(stack: Stack, browser: Browser) -> None:
    """A user with the level observe sees the robot live, without controls."""
    page_users = PageUsers(stack, browser)
    page_users.let("otto", "observe", "sim1")
    try:
        watching = page_users.open_fleet("otto")
        expect(watching.get_by_test_id("robot-card-sim1")).to_be_visible()
        expect(watching.get_by_test_id("robot-card-sim2")).to_have_count(0)
        open_robot(watching, stack, "sim1")
        expect(watching.get_by_test_id("joystick")).to_have_count(0)
        with SimWatch(stack, "sim1") as watch:
            watching.keyboard.down("w")
            # For a moment: until it is measured there is a dash.
            expect(watching.get_by_test_id("rtt")).to_have_text(re.compile(r"\d+ ms"))
            watching.keyboard.up("w")
            assert watch.commands() == []
    finally:
        page_users.close()

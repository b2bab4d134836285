"""Anybody who sees a robot stops it, everybody sees that at once, and only a deliberate release ends it.

What a page says of a stop in which state, its two ways to the server and how long a release is held are unit tests of
stopping.js and stopBar.js; which stop a release ends is a rule of the relay.
"""

import re
import time
from contextlib import closing

import page_holds
import pytest
from page_users import PageUsers, release_all
from pages import expect_armed, expect_mode
from playwright.sync_api import expect
from sim_watch import SimWatch

ROBOT = "sim1"
SIMS = ("sim1", "sim2", "sim3")


@pytest.fixture
def page_users(stack, browser):
    """Ann, who may drive, and Olga, who may watch; nobody drives yet, and afterwards no robot is stopped."""
    for robot in SIMS:
        stack.wait_until_drivable(robot)
    try:
        with closing(PageUsers(stack, browser)) as people:
            people.let("ann", "drive", ROBOT)
            people.let("olga", "observe", ROBOT)
            yield people
    finally:
        release_all(stack, list(SIMS))


def _expect_stopped(page, by):
    bar = page.get_by_test_id("stop-bar")
    expect(bar).to_have_attribute("data-stop", "stopped")
    expect(page.get_by_test_id("stop-text")).to_have_text(
        re.compile(rf"Stopped by {by} at \d\d:\d\d")
    )


def test_a_stop_reaches_driver_and_robot_outlives_the_page_and_ends_by_a_release(page_users, stack):
    """An observer presses; what is held drives no more; the driver's release gives the control back to her."""
    ann, olga = page_users.drive("ann", ROBOT), page_users.open("olga", ROBOT)
    with SimWatch(stack, ROBOT) as watch:
        ann.bring_to_front()
        page_holds.drive(ann, watch)
        olga.get_by_test_id("stop").dispatch_event("pointerdown", {"button": 0})
        watch.wait_standing()
        _expect_stopped(ann, "olga")
        stopped = time.monotonic()
        expect_mode(ann, "observe")
        expect(ann.get_by_test_id("state")).to_have_attribute("data-shown", "stopped")
        expect(ann.get_by_test_id("state")).to_contain_text("By olga at")
        ann.keyboard.down("w")  # of a key that is down, a repeat
        expect(ann.get_by_test_id("release")).to_have_text("Hold to drive again")
        ann.keyboard.up("w")
        assert [seen for seen in watch.commands(stopped) if seen.msg["linear"]["x"] != 0] == []
        expect(olga.get_by_test_id("release")).to_have_count(0)
        page_holds.release_stop(ann)
        expect_mode(ann, "drive")
        expect_armed(ann)
        page_holds.drive(ann, watch)
        ann.keyboard.press("Space")
        _expect_stopped(ann, "ann")
        ann.keyboard.up("w")
    page_users.go(ann, ROBOT)
    _expect_stopped(ann, "ann")
    expect(ann.get_by_test_id("control-drive")).to_be_hidden()
    page_holds.release_stop(ann)
    expect_mode(ann, "observe")


def test_robots_are_stopped_on_the_fleet_page(page_users, stack):
    """Everybody stops one by its card; a manager stops those of a site or all, and reads what became of each."""
    olga = page_users.open_fleet("olga")
    card = olga.get_by_test_id(f"robot-card-{ROBOT}")
    card.get_by_test_id("card-stop").click()
    expect(card.get_by_test_id("card-stopped")).to_contain_text("Stopped by olga at")
    expect(olga.get_by_test_id("stop-all")).to_be_hidden()
    release_all(stack, [ROBOT])
    stack.admin.ask("POST", "/sites", {"name": "lab"})
    try:
        stack.robotether("site", "place", "sim2", "lab")
        admin = page_users.open_fleet("admin")
        result = admin.get_by_test_id("stop-result")
        admin.get_by_test_id("stop-site-lab").click(timeout=15_000)
        expect(result).to_have_text("sim2: stopped")
        for name, stop in (("sim1", "none"), ("sim2", "stopped")):
            card = admin.get_by_test_id(f"robot-card-{name}")
            expect(card).to_have_attribute("data-stop", stop)
        admin.get_by_test_id("stop-all").click()
        for name in SIMS:
            expect(result).to_contain_text(re.compile(rf"{name}: stopped"))
    finally:
        stack.admin.remove("sites", "lab")

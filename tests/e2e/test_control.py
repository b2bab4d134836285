"""Two people and one robot: who drives, who asks, and how the control goes from page to page.

Each person has a browser of their own, in front of the whole stack. What each side says in which state are unit tests
of driveMode.js and of the relay's leases.
"""

import re
from contextlib import closing

import page_holds
import pytest
from page_users import PageUsers
from pages import answer, expect_mode, take_control
from playwright.sync_api import expect
from sim_watch import SimWatch

ROBOT = "sim1"


@pytest.fixture
def page_users(stack, browser):
    """Ann and Ben, who may drive; nobody drives yet."""
    stack.wait_until_drivable(ROBOT)
    with closing(PageUsers(stack, browser)) as people:
        for name in ("ann", "ben"):
            people.let(name, "drive", ROBOT)
        yield people


def _ask(asking, asked):
    asking.get_by_test_id("control-ask").click()
    expect(asked.get_by_test_id("question")).to_contain_text("ben asks for control")


def _assert_drives_only_after_a_word(page, stack):
    """Control that came by itself moves nothing until the person begins."""
    with SimWatch(stack, ROBOT) as watch:
        page.keyboard.press("w", delay=500)
        assert [seen for seen in watch.commands() if seen.msg["linear"]["x"] != 0] == []
        page.get_by_test_id("control-arm").click()
        page_holds.drive(page, watch)
        page.keyboard.up("w")
        watch.wait_standing()


def _newest_fence(stack):
    """The number of the robot's last lease, which each drive raises."""
    of_robot = f"robot_id = (SELECT id FROM robots WHERE name = '{ROBOT}')"
    [[fence]] = stack.sql(f"SELECT COALESCE(MAX(fence), 0) FROM drives WHERE {of_robot}")
    return int(fence)


def test_control_is_taken_asked_for_refused_handed_over_and_taken_away(page_users, stack):
    before = _newest_fence(stack)
    ann, ben = (page_users.open(name, ROBOT) for name in ("ann", "ben"))
    for page in (ann, ben):
        expect_mode(page, "observe")
        expect(page.get_by_test_id("driver")).to_have_text("Nobody is driving")
    assert _newest_fence(stack) == before
    take_control(ann)
    drives = re.compile(r"ann is driving \(since \d\d:\d\d\)")
    expect(ben.get_by_test_id("driver")).to_have_text(drives)
    with SimWatch(stack, ROBOT) as watch:
        ben.keyboard.press("w", delay=500)
        note = ben.get_by_test_id("control-note")
        expect(note).to_have_text("ann is driving. To drive, ask for control.")
        assert watch.commands() == []
    _ask(ben, ann)
    answer(ann, "refuse")
    expect(note).to_have_text("ann refused your request.")
    expect_mode(ann, "drive")
    _ask(ben, ann)
    expect(ben.get_by_test_id("control-left")).to_contain_text("You asked ann")
    answer(ann, "hand-over")
    expect_mode(ben, "drive")
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("control-note")).to_have_text("You handed control to ben.")
    ann.close()
    _assert_drives_only_after_a_word(ben, stack)
    admin = page_users.open("admin", ROBOT)
    for sure in ("take-no", "take-yes"):
        expect_mode(ben, "drive")
        admin.get_by_test_id("control-take").click()
        expect(admin.get_by_test_id("take-sure")).to_contain_text("Take control from ben?")
        answer(admin, sure)
        expect(admin.get_by_test_id("take-sure")).to_be_hidden()
    expect_mode(admin, "drive")
    expect_mode(ben, "observe")
    expect(note).to_contain_text("You no longer drive")

"""Two people and one robot: who drives, who asks, and how the control goes from page to page.

Each person has a browser of their own, in front of the whole stack.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import closing

import pytest
from crew import Crew, expect_mode
from pages import expect_armed, expect_live
from playwright.sync_api import Browser, Page, expect
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim1"


@pytest.fixture
def crew(stack: Stack, browser: Browser) -> Iterator[Crew]:
    """Ann and Ben, who may drive, and Olga, who may watch; nobody drives yet."""
    stack.wait_until_drivable(ROBOT)
    with closing(Crew(stack, browser)) as people:
        for name, level in (("ann", "drive"), ("ben", "drive"), ("olga", "observe")):
            people.let(name, level, ROBOT)
        yield people


@pytest.fixture
def usual_policy(stack: Stack) -> Iterator[None]:
    """The test may change the number of subscriptions, which is the usual one again for those that follow."""
    yield
    stack.admin.set_robot(ROBOT, {"policy.limits.subscriptions": None})
    stack.wait_for_changes(ROBOT)


@pytest.fixture
def ann(crew: Crew) -> Page:
    """Ann's page: she drives."""
    page = crew.open("ann", ROBOT)
    expect_mode(page, "drive")
    expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")
    return page


@pytest.fixture
def ben(crew: Crew, ann: Page) -> Page:
    """Ben's page: he came second, so he watches."""
    page = crew.open("ben", ROBOT)
    expect_mode(page, "observe")
    return page


def _moving(pose: dict[str, float]) -> bool:
    return pose["linear_velocity"] > 0.1


def _ask(asking: Page, asked: Page) -> None:
    asking.get_by_test_id("control-ask").click()
    expect(asked.get_by_test_id("question")).to_be_visible()
    expect(asked.get_by_test_id("question")).to_contain_text("ben asks for control")


def _assert_drives_only_after_a_word(page: Page, stack: Stack) -> None:
    """Control that came by itself moves nothing until the person begins."""
    with SimWatch(stack, ROBOT) as watch:
        page.keyboard.press("w", delay=500)
        assert [seen for seen in watch.commands() if seen.msg["linear"]["x"] != 0] == []
        page.get_by_test_id("control-arm").click()
        expect_armed(page)
        page.keyboard.down("w")
        watch.wait_pose("moving", _moving)
        page.keyboard.up("w")
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)


def test_the_second_one_watches_and_reads_who_drives(crew: Crew, ann: Page, ben: Page) -> None:
    """Who comes second reads who drives since when and may ask; who may only watch reads the same."""
    drives = re.compile(r"ann drives since \d\d:\d\d")
    expect(ben.get_by_test_id("driver")).to_have_text(drives)
    expect(ben.get_by_test_id("control-ask")).to_be_visible()
    expect(ben.get_by_test_id("control-take")).to_be_hidden()
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    olga = crew.open("olga", ROBOT)
    expect(olga.get_by_test_id("driver")).to_have_text(drives)
    expect(olga.get_by_test_id("control-ask")).to_be_hidden()
    expect(ann.get_by_test_id("driver")).to_contain_text("You drive since")
    expect(ann.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")


def test_the_driver_hands_over(ann: Page, ben: Page, stack: Stack) -> None:
    """The control comes to who asked, without a further press, and drives only after one."""
    _ask(ben, ann)
    expect(ben.get_by_test_id("control-left")).to_contain_text("You asked ann")
    ann.get_by_test_id("hand-over").click()
    expect_mode(ben, "drive")
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("control-note")).to_contain_text("You no longer drive")
    expect(ann.get_by_test_id("driver")).to_contain_text("ben drives")
    expect(ann.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    _assert_drives_only_after_a_word(ben, stack)


def test_the_driver_refuses_and_drives_on(ann: Page, ben: Page) -> None:
    """Who asked reads the no, and may ask again."""
    _ask(ben, ann)
    ann.get_by_test_id("refuse").click()
    expect(ben.get_by_test_id("control-note")).to_have_text("ann said no.")
    expect(ann.get_by_test_id("question")).to_be_hidden()
    expect_mode(ann, "drive")
    expect_mode(ben, "observe")
    _ask(ben, ann)
    ben.get_by_test_id("control-withdraw").click()
    expect(ann.get_by_test_id("question")).to_be_hidden()


def test_without_an_answer_the_control_passes_on(ann: Page, ben: Page, stack: Stack) -> None:
    """Both see 20 s count down; then the control is with who asked."""
    before = time.monotonic()
    _ask(ben, ann)
    asked = time.monotonic()
    for words in (ann.get_by_test_id("question-left"), ben.get_by_test_id("control-left")):
        expect(words).to_contain_text(re.compile(r" in 1\d s"), timeout=8_000)
    expect(ann.get_by_test_id("control")).to_have_attribute("data-mode", "observe", timeout=25_000)
    passed = time.monotonic()
    assert passed - before >= 20
    assert passed - asked < 24
    expect_mode(ben, "drive")
    expect_mode(ann, "observe")
    _assert_drives_only_after_a_word(ben, stack)


def test_a_driver_who_leaves_leaves_the_control_to_who_asked(ann: Page, ben: Page) -> None:
    """Who asked need not wait for the 20 s when the driver's page is gone."""
    _ask(ben, ann)
    ann.close()
    expect_mode(ben, "drive", seconds=8)
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")


def test_a_manager_takes_the_control_after_a_second_thought(crew: Crew, ann: Page) -> None:
    """Taking asks once more; no changes nothing, yes ends the driver's lease at once."""
    admin = crew.open("admin", ROBOT)
    expect_mode(admin, "observe")
    admin.get_by_test_id("control-take").click()
    expect(admin.get_by_test_id("take-sure")).to_contain_text("Take the control from ann?")
    admin.get_by_test_id("take-no").click()
    expect(admin.get_by_test_id("take-sure")).to_be_hidden()
    expect_mode(ann, "drive")
    admin.get_by_test_id("control-take").click()
    admin.get_by_test_id("take-yes").click()
    expect_mode(admin, "drive")
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("driver")).to_contain_text("admin drives")
    expect(ann.get_by_test_id("control-note")).to_contain_text("You no longer drive")


def test_a_second_window_goes_on_and_the_first_one_watches(crew: Crew, ann: Page) -> None:
    """The first window says so, takes nothing back by itself, and drives again by a press."""
    second = ann.context.new_page()
    crew.go(second, ROBOT)
    expect_mode(second, "drive")
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("control-note")).to_contain_text("another window")
    expect(ann.get_by_test_id("driver")).to_contain_text("You drive in another window")
    ann.bring_to_front()
    ann.get_by_test_id("control-drive").click()
    expect_mode(ann, "drive")
    expect_mode(second, "observe")


def test_control_that_was_given_up_is_free(ann: Page, ben: Page) -> None:
    """Who gives it up watches, and nobody gets it without a press."""
    ann.get_by_test_id("control-leave").click()
    expect_mode(ann, "observe")
    expect(ben.get_by_test_id("driver")).to_have_text("Nobody drives.")
    expect_mode(ben, "observe")
    ben.get_by_test_id("control-drive").click()
    expect_mode(ben, "drive")
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")


@pytest.mark.usefixtures("usual_policy")
def test_a_new_policy_ends_a_motion_and_not_the_drive(ann: Page, stack: Stack) -> None:
    """The page comes back by itself, and what was held before moves nothing more until it is pressed anew."""
    with SimWatch(stack, ROBOT) as watch:
        expect_armed(ann)
        ann.keyboard.down("w")
        watch.wait_pose("moving", _moving)
        # The page opens its connection anew.
        with ann.expect_websocket(lambda socket: "/ros?" in socket.url):
            stack.admin.set_robot(ROBOT, {"policy.limits.subscriptions": 99})
        expect_live(ann, seconds=10)
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
        ann.keyboard.up("w")
        expect_armed(ann)
        ann.keyboard.down("w")
        watch.wait_pose("moving again", _moving)
        ann.keyboard.up("w")

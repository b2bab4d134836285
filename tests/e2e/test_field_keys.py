"""The keys drive whatever was used before, and a field that keeps keys to itself says so.

In a real browser with real lists and sliders: only there shows who gets a key. What drives is looked at on the robot.
"""

from __future__ import annotations

import time

import pytest
from page_users import release_all
from pages import drive_live, expect_armed, open_drawer
from playwright.sync_api import Locator, Page, expect
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim1"
ZERO = {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
MENUS = ("quality", "layout")
SLIDERS = ("limit-linear", "limit-angular")


@pytest.fixture
def robot(page: Page, stack: Stack) -> Page:
    """The robot's page, which drives, with all its cameras found."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    expect(page.get_by_test_id("camera").get_by_role("button")).to_have_count(3)
    open_drawer(page)
    expect_armed(page)
    return page


def _expect_drives(page: Page, watch: SimWatch, *keys: str) -> None:
    """Each key drives while it is held."""
    for key in keys:
        expect_armed(page)
        page.keyboard.down(key)
        watch.wait_pose(f"moving by {key}", lambda pose: pose["linear_velocity"] > 0.05)
        page.keyboard.up(key)
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)


def _assert_not_driven(watch: SimWatch, since: float) -> None:
    time.sleep(0.3)  # in which a command would have come
    moved = [seen.msg for seen in watch.commands(since) if seen.msg != ZERO]
    assert moved == []


def _taken(page: Page) -> Locator:
    return page.get_by_test_id("keys-taken")


def test_a_menu_that_was_opened_and_closed_keeps_no_key(robot: Page, stack: Stack) -> None:
    """Looked into by pointer and left as it was: its list has the keys while it is open, and the robot after that."""
    with SimWatch(stack, ROBOT) as watch:
        for name in MENUS:
            menu = robot.get_by_test_id(name)
            before = menu.input_value()
            menu.click()
            opened = time.monotonic()
            robot.keyboard.press("ArrowDown")
            robot.keyboard.press("ArrowUp")
            robot.keyboard.press("Escape")
            _assert_not_driven(watch, opened)
            _expect_drives(robot, watch, "w", "ArrowUp")
            assert menu.input_value() == before, name
            expect(_taken(robot)).to_be_empty()
            if name == "quality":
                robot.get_by_test_id("drawer-open").click()  # it lies over the other one


def test_a_view_that_was_clicked_keeps_no_key(robot: Page, stack: Stack) -> None:
    """One click makes it the main one; then the keys drive, Enter chooses it again and Space is Stop."""
    rear = robot.get_by_test_id("view-2")
    with SimWatch(stack, ROBOT) as watch:
        clicked = time.monotonic()
        rear.click()
        expect(rear).to_have_attribute("aria-pressed", "true")
        _assert_not_driven(watch, clicked)
        _expect_drives(robot, watch, "w", "ArrowUp")
        robot.keyboard.press("Enter")
        expect(rear).to_have_attribute("aria-pressed", "true")
        expect(_taken(robot)).to_be_empty()
        # A click by Space would choose it once more.
        robot.keyboard.press("1")
        expect(rear).to_have_attribute("aria-pressed", "false")
        try:
            robot.keyboard.press("Space")
            expect(robot.get_by_test_id("release")).to_be_visible()
            expect(rear).to_have_attribute("aria-pressed", "false")
        finally:
            release_all(stack, [ROBOT])


def test_a_menu_in_which_something_was_chosen_keeps_no_key(robot: Page, stack: Stack) -> None:
    """The choice counts, and the next arrow key drives."""
    menu = robot.get_by_test_id("quality")
    menu.click()
    robot.keyboard.press("ArrowDown")
    robot.keyboard.press("Enter")
    expect(menu).to_have_value("90")
    with SimWatch(stack, ROBOT) as watch:
        _expect_drives(robot, watch, "ArrowUp", "w")
    assert menu.input_value() == "90"


def test_a_slider_that_was_clicked_keeps_no_key(robot: Page, stack: Stack) -> None:
    """The limit is where it was clicked, and stays there while the arrow keys drive."""
    with SimWatch(stack, ROBOT) as watch:
        for name in SLIDERS:
            slider = robot.get_by_test_id(name)
            slider.click()
            chosen = slider.input_value()
            _expect_drives(robot, watch, "ArrowUp", "w")
            assert slider.input_value() == chosen, name


def test_who_comes_by_tab_moves_a_slider_and_reads_how_to_drive(robot: Page, stack: Stack) -> None:
    """The arrow keys are the slider's and the page says so; letters drive; after Esc the arrows drive too."""
    slider = robot.get_by_test_id("limit-linear")
    most = float(slider.input_value())
    robot.get_by_test_id("stick-right").focus()
    robot.keyboard.press("Tab")
    expect(slider).to_be_focused()
    expect(_taken(robot)).to_have_text("Arrow keys move the slider. Press Esc to drive with them.")
    with SimWatch(stack, ROBOT) as watch:
        began = time.monotonic()
        robot.keyboard.press("ArrowLeft")
        assert float(slider.input_value()) < most
        _assert_not_driven(watch, began)
        _expect_drives(robot, watch, "w")
        robot.keyboard.press("Escape")
        expect(_taken(robot)).to_be_empty()
        chosen = slider.input_value()
        _expect_drives(robot, watch, "ArrowUp")
    assert slider.input_value() == chosen


def test_what_is_typed_never_drives(robot: Page, stack: Stack) -> None:
    """A key that is held is let go when a text field gets the focus, and what is typed there is text."""
    robot.get_by_test_id("topics").locator("summary").click()
    search = robot.get_by_test_id("topic-search")
    with SimWatch(stack, ROBOT) as watch:
        robot.keyboard.down("w")
        watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0.05)
        search.click()
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0, seconds=1)
        robot.keyboard.up("w")
        typing = time.monotonic()
        search.press_sequentially("wasd")
        robot.keyboard.press("ArrowUp")
        _assert_not_driven(watch, typing)
        expect(search).to_have_value("wasd")
        expect(_taken(robot)).to_have_text(
            "Keys go to the text field. Press Esc to drive with them."
        )
        robot.keyboard.press("Escape")
        _expect_drives(robot, watch, "w")

"""Where things stand on the drive page: picture, stick and Stop on the screen at once, and nothing moves the stick."""

from __future__ import annotations

import pytest
from pages import expect_no_sideways_scroll, open_robot
from playwright.sync_api import FloatRect, Page, expect
from sim_service import frozen_cameras
from stack import Stack

ROBOT = "sim1"
PHONE = {"has_touch": True, "is_mobile": True}
SCREENS = {
    "small phone": {"viewport": {"width": 360, "height": 740}, **PHONE},
    "phone sideways": {"viewport": {"width": 740, "height": 360}, **PHONE},
    "tablet": {"viewport": {"width": 820, "height": 1180}, **PHONE},
    "laptop": {"viewport": {"width": 1280, "height": 800}},
    "wall": {"viewport": {"width": 2560, "height": 1440}},
}


def _box(page: Page, name: str) -> FloatRect:
    box = page.get_by_test_id(name).bounding_box()
    assert box is not None, f"{name} is not to be seen"
    return box


@pytest.mark.parametrize("context", SCREENS.values(), ids=SCREENS, indirect=True)
def test_picture_stick_and_stop_are_on_the_screen_at_once(page: Page, stack: Stack) -> None:
    """Nobody who drives has to scroll for one of them, and Stop covers no part of the stick."""
    open_robot(page, stack, ROBOT)
    expect_no_sideways_scroll(page)
    size = page.viewport_size
    assert size is not None
    stage, stick, stop, bar = (
        _box(page, name) for name in ("stage", "joystick", "stop", "stop-bar")
    )
    assert stage["height"] >= 120
    assert stage["y"] + stage["height"] <= bar["y"]
    assert stick["y"] + stick["height"] <= bar["y"]
    assert stop["y"] + stop["height"] <= size["height"]
    assert min(stop["width"], stop["height"]) >= 44


@pytest.mark.parametrize("context", SCREENS.values(), ids=SCREENS, indirect=True)
def test_what_appears_while_somebody_drives_does_not_move_the_stick(
    page: Page, stack: Stack
) -> None:
    """Held for a picture and driving without it: the stick stays where the finger is."""
    stack.wait_until_drivable(ROBOT)
    open_robot(page, stack, ROBOT)
    before = _box(page, "joystick")
    state = page.get_by_test_id("state")
    with frozen_cameras(stack, ROBOT):
        expect(state).to_have_attribute("data-shown", "held", timeout=5_000)
        assert _box(page, "joystick") == before
        page.get_by_test_id("state-action").click()
        expect(state).to_have_attribute("data-shown", "blind")
        assert _box(page, "joystick") == before

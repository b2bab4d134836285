"""Where things stand on the drive page: picture, stick and Stop on the screen at once, and nothing moves the stick."""

from __future__ import annotations

import pytest
from pages import drive_robot, expect_no_sideways_scroll
from playwright.sync_api import Browser, FloatRect, Page, expect
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


# Of each thing that may lie over the picture: what of it can be seen over a question, which shows by force here.
OVER_A_QUESTION = """() => {
  const question = document.querySelector('[data-testid=question]');
  question.hidden = false;
  const chips = document.querySelectorAll('[data-testid=battery], [data-testid=diagnostics]');
  const found = [...chips].map((chip) => {
    chip.hidden = false;
    if (!chip.textContent.trim()) chip.append('chip');
    const [a, b] = [chip.getBoundingClientRect(), question.getBoundingClientRect()];
    const [left, right] = [Math.max(a.left, b.left), Math.min(a.right, b.right)];
    const [top, bottom] = [Math.max(a.top, b.top), Math.min(a.bottom, b.bottom)];
    if (right <= left || bottom <= top) return 'beside';
    const on = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
    return question.contains(on) ? 'under' : 'over';
  });
  question.hidden = true;
  return found;
}"""


def _box(page: Page, name: str) -> FloatRect:
    box = page.get_by_test_id(name).bounding_box()
    assert box is not None, f"{name} is not to be seen"
    return box


@pytest.mark.parametrize("context", SCREENS.values(), ids=SCREENS, indirect=True)
def test_picture_stick_and_stop_are_on_the_screen_at_once(page: Page, stack: Stack) -> None:
    """Nobody who drives has to scroll for one of them, and Stop covers no part of the stick."""
    drive_robot(page, stack, ROBOT)
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
def test_nothing_lies_over_a_question(page: Page, stack: Stack) -> None:
    """Battery and diagnostics lie over the picture and under what somebody is asked."""
    drive_robot(page, stack, ROBOT)
    expect(page.get_by_test_id("battery")).to_be_visible(timeout=10_000)
    assert "over" not in page.evaluate(OVER_A_QUESTION)


@pytest.mark.parametrize(
    "context", [SCREENS["small phone"], SCREENS["laptop"]], ids=["phone", "laptop"], indirect=True
)
def test_stop_names_its_key_where_there_are_keys(page: Page, stack: Stack) -> None:
    """On Stop itself and beside the keys that drive; a phone has no space bar."""
    drive_robot(page, stack, ROBOT)
    has_keys = page.evaluate("matchMedia('(hover: hover) and (pointer: fine)').matches")
    on_stop = page.get_by_test_id("stop").locator("kbd")
    expect(on_stop).to_be_visible(visible=has_keys)
    expect(page.get_by_text("Space = Stop")).to_be_visible(visible=has_keys)


def test_without_scripts_the_page_says_so_and_shows_no_dead_stop(
    stack: Stack, page: Page, browser: Browser
) -> None:
    """Neither Stop nor anything else that would do nothing is there; the way back to the robots is."""
    state = page.context.storage_state()
    plain = browser.new_context(
        ignore_https_errors=True, java_script_enabled=False, storage_state=state
    )
    try:
        dead = plain.new_page()
        dead.goto(f"{stack.url}/robots/{ROBOT}")
        words = dead.locator("noscript p")
        expect(words).to_be_visible()
        expect(words).to_contain_text("Driving and stopping need JavaScript")
        for name in ("stop", "state", "control", "joystick", "stage"):
            expect(dead.get_by_test_id(name)).to_be_hidden()
        expect(dead.get_by_role("link", name="Robots").first).to_be_visible()
    finally:
        plain.close()


@pytest.mark.parametrize("context", SCREENS.values(), ids=SCREENS, indirect=True)
def test_what_appears_while_somebody_drives_does_not_move_the_stick(
    page: Page, stack: Stack
) -> None:
    """Held for a picture and driving without it: the stick stays where the finger is."""
    stack.wait_until_drivable(ROBOT)
    drive_robot(page, stack, ROBOT)
    before = _box(page, "joystick")
    state = page.get_by_test_id("state")
    with frozen_cameras(stack, ROBOT):
        expect(state).to_have_attribute("data-shown", "held", timeout=5_000)
        assert _box(page, "joystick") == before
        page.get_by_test_id("state-action").click()
        expect(state).to_have_attribute("data-shown", "blind")
        assert _box(page, "joystick") == before

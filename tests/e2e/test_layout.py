"""The layout of the drive page: video, stick and Stop on the screen at once, and nothing moves the stick.

One page takes all sizes of a screen in turn, as a window does that is resized or a phone that is turned.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from pages import drive_live, expect_no_sideways_scroll
from playwright.sync_api import Browser, FloatRect, Page, ViewportSize, expect
from sim_service import frozen_cameras
from stack import Stack

ROBOT = "sim1"
MOUSE = {"viewport": {"width": 1280, "height": 800}}
TOUCH = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
SIZES = {
    "mouse": [(1280, 800), (1920, 1080), (2560, 1440)],
    "touch": [(360, 740), (740, 360), (390, 844), (844, 390), (820, 1180)],
}
# Shows by force what somebody is asked, with its words: where the questions are, and whether what may lie
# over the picture can be seen over them.
QUESTIONS = """() => {
  const questions = [...document.querySelectorAll('.question')];
  const chips = [...document.querySelectorAll('[data-testid=battery], [data-testid=diagnostics]')];
  for (const question of questions) {
    question.hidden = false;
    question.querySelector('[data-part=text]').textContent = 'ben asks for control.';
    const left = question.querySelector('[data-part=left]');
    if (left) left.textContent = 'If you neither reply nor drive, control passes to ben in 20 s.';
  }
  const boxes = questions.map((question) => question.getBoundingClientRect());
  const chipsAre = chips.map((chip) => {
    chip.hidden = false;
    if (!chip.textContent.trim()) chip.append('chip');
    const a = chip.getBoundingClientRect();
    return questions.map((question, place) => {
      const b = boxes[place];
      const [left, right] = [Math.max(a.left, b.left), Math.min(a.right, b.right)];
      const [top, bottom] = [Math.max(a.top, b.top), Math.min(a.bottom, b.bottom)];
      if (right <= left || bottom <= top) return 'beside';
      return question.contains(document.elementFromPoint((left + right) / 2, (top + bottom) / 2)) ? 'under' : 'over';
    });
  });
  const stick = document.querySelector('[data-testid=joystick]').getBoundingClientRect();
  const [x, y] = [stick.left + stick.width / 2, stick.top + stick.height / 2];
  const hit = [0, 6, 60].map((below) =>
    document.elementFromPoint(x, y + below).closest('[data-testid]').dataset.testid);
  for (const question of questions) question.hidden = true;
  const alone = questions.map((question) => {
    question.hidden = false;
    const box = question.getBoundingClientRect();
    question.hidden = true;
    return box;
  });
  return { together: boxes, alone, chips: chipsAre.flat(), hit };
}"""
BOTH = pytest.mark.parametrize("context", [MOUSE, TOUCH], ids=list(SIZES), indirect=True)


@pytest.fixture
def driven(page: Page, stack: Stack) -> Page:
    """The robot's page, which drives."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    return page


def _at_each_size(page: Page, request: pytest.FixtureRequest) -> Iterator[str]:
    """Resize the page, and say to what."""
    for width, height in SIZES[request.node.callspec.id]:
        page.set_viewport_size(ViewportSize(width=width, height=height))
        yield f"at {width}x{height}"


def _box(page: Page, name: str) -> FloatRect:
    box = page.get_by_test_id(name).bounding_box()
    assert box is not None, f"{name} is not to be seen"
    return box


def _overlap(one: FloatRect, other: FloatRect) -> bool:
    return (
        one["x"] < other["x"] + other["width"]
        and other["x"] < one["x"] + one["width"]
        and one["y"] < other["y"] + other["height"]
        and other["y"] < one["y"] + one["height"]
    )


@BOTH
def test_picture_stick_and_stop_are_on_the_screen_at_once(
    driven: Page, request: pytest.FixtureRequest
) -> None:
    """Nobody who drives has to scroll for one of them, and Stop covers no part of the stick."""
    for size in _at_each_size(driven, request):
        expect_no_sideways_scroll(driven)
        assert driven.viewport_size is not None
        stage, stick, stop, bar = (
            _box(driven, name) for name in ("stage", "joystick", "stop", "stop-bar")
        )
        assert stage["height"] >= 120, size
        assert stage["y"] + stage["height"] <= bar["y"], size
        assert stick["y"] + stick["height"] <= bar["y"], size
        assert stop["y"] + stop["height"] <= driven.viewport_size["height"], size
        assert min(stop["width"], stop["height"]) >= 44, size


@BOTH
def test_a_question_covers_neither_stick_nor_stop_and_nothing_lies_over_it(
    driven: Page, request: pytest.FixtureRequest
) -> None:
    """Each, and where they fit both at once, which never comes; battery and diagnostics are under them."""
    expect(driven.get_by_test_id("battery")).to_be_visible(timeout=10_000)
    driven.get_by_test_id("two-sticks").click()
    for size in _at_each_size(driven, request):
        found = driven.evaluate(QUESTIONS)
        boxes = found["alone"]
        if driven.viewport_size is not None and driven.viewport_size["height"] > 360:
            boxes += found["together"]
        assert len(boxes) >= 2
        for box in boxes:
            assert min(box["width"], box["height"]) > 40, f"{size} a question does not show"
            for name in ("joystick", "joystick-turn", "stop"):
                assert not _overlap(box, _box(driven, name)), f"{size} it covers {name}"
        assert "over" not in found["chips"], size
        assert found["hit"] == ["joystick"] * 3, size


@BOTH
def test_stop_names_its_key_where_there_are_keys(
    driven: Page, request: pytest.FixtureRequest
) -> None:
    """On Stop itself and beside the keys that drive; a phone has no space bar."""
    has_keys = driven.evaluate("matchMedia('(hover: hover) and (pointer: fine)').matches")
    assert has_keys == (request.node.callspec.id == "mouse")
    expect(driven.get_by_test_id("stop").locator("kbd")).to_be_visible(visible=has_keys)
    expect(driven.get_by_text("Space = Stop")).to_be_visible(visible=has_keys)


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


@BOTH
def test_what_appears_while_somebody_drives_does_not_move_the_stick(
    driven: Page, stack: Stack, request: pytest.FixtureRequest
) -> None:
    """Held for a picture and driving without it: the stick stays where the finger is."""
    state = driven.get_by_test_id("state")
    before = {size: _box(driven, "joystick") for size in _at_each_size(driven, request)}
    with frozen_cameras(stack, ROBOT):
        expect(state).to_have_attribute("data-shown", "held", timeout=5_000)
        held = {size: _box(driven, "joystick") for size in _at_each_size(driven, request)}
        driven.get_by_test_id("state-action").click()
        expect(state).to_have_attribute("data-shown", "blind")
        blind = {size: _box(driven, "joystick") for size in _at_each_size(driven, request)}
    assert held == before
    assert blind == before

"""What comes up by itself while somebody drives covers neither stick nor Stop, nor is it answered by a slip."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from contextlib import closing

import pytest
from page_users import PageUsers
from pages import drive_live, expect_armed, expect_mode
from playwright.sync_api import Browser, FloatRect, Page, expect
from stack import Stack

ROBOT = "sim1"
TOUCH = {"has_touch": True, "is_mobile": True}
SCREENS = {
    "1280x800": {"viewport": {"width": 1280, "height": 800}},
    "1920x1080": {"viewport": {"width": 1920, "height": 1080}},
    "820x1180": {"viewport": {"width": 820, "height": 1180}, **TOUCH},
    "390x844": {"viewport": {"width": 390, "height": 844}, **TOUCH},
    "844x390": {"viewport": {"width": 844, "height": 390}, **TOUCH},
}
# A thumb that is already on its way presses in the moment in which the question comes up, whatever that is.
PRESS_AT_ONCE = """() => {
  const question = document.querySelector("[data-testid=question]");
  new MutationObserver(() => {
    if (question.hidden) return;
    for (const name of ["hand-over", "refuse"]) question.querySelector(`[data-testid=${name}]`).click();
    window.pressedAtOnce = true;
  }).observe(question, { attributes: true, attributeFilter: ["hidden"] });
}"""
# Of both at once, which is more than ever comes.
BOXES = """() => {
  const sure = document.querySelector("[data-testid=take-sure]");
  sure.hidden = false;
  const found = [...document.querySelectorAll(".question")].map((one) => one.getBoundingClientRect().toJSON());
  sure.hidden = true;
  return found;
}"""
HIT = """([x, y]) => document.elementFromPoint(x, y).closest("[data-testid]").dataset.testid"""


@pytest.fixture
def asking(stack: Stack, browser: Browser, request: pytest.FixtureRequest) -> Iterator[Asking]:
    """Somebody new, as the server lets nobody ask again and again."""
    stack.wait_until_drivable(ROBOT)
    name = f"ben{request.node.callspec.id}"
    with closing(PageUsers(stack, browser)) as people:
        people.let(name, "drive", ROBOT)
    yield Asking(stack, name)
    # Whom the control was handed to never takes it; without a user it is kept for nobody.
    stack.admin.remove("users", name)
    stack.wait_until_free(ROBOT)


class Asking:
    """Who asks the driver for the control, without a page."""

    def __init__(self, stack: Stack, name: str) -> None:
        self.name = name
        self._stack = stack
        self._headers = {"Authorization": f"Bearer {stack.token('asks', user=name)}"}

    def ask(self) -> None:
        """Ask once."""
        status, answer = self._stack.request(
            "POST", f"/api/v1/robots/{ROBOT}/lease", {"action": "ask"}, self._headers
        )
        assert status == http.client.OK, answer


def _box(page: Page, test_id: str) -> FloatRect:
    box = page.get_by_test_id(test_id).bounding_box()
    assert box is not None, f"{test_id} is not to be seen"
    return box


def _overlap(one: FloatRect, other: FloatRect) -> bool:
    return (
        one["x"] < other["x"] + other["width"]
        and other["x"] < one["x"] + one["width"]
        and one["y"] < other["y"] + other["height"]
        and other["y"] < one["y"] + one["height"]
    )


def _centre(box: FloatRect) -> tuple[float, float]:
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def _press_answers(page: Page) -> None:
    for name in ("hand-over", "refuse"):
        page.get_by_test_id(name).evaluate("button => button.click()")


def _expect_unanswered(page: Page) -> None:
    page.wait_for_timeout(300)
    expect_mode(page, "drive")
    expect(page.get_by_test_id("question")).to_be_visible()


@pytest.mark.parametrize("context", SCREENS.values(), ids=SCREENS, indirect=True)
def test_a_question_covers_neither_stick_nor_stop_and_hears_no_slip(
    page: Page, stack: Stack, asking: Asking
) -> None:
    """Deaf for its first 0.7 s and while stick or key is held; then a press hands over."""
    drive_live(page, stack, ROBOT)
    page.get_by_test_id("two-sticks").click()
    expect_armed(page)
    page.evaluate(PRESS_AT_ONCE)
    asking.ask()
    question = page.get_by_test_id("question")
    expect(question).to_contain_text(f"{asking.name} asks for control")
    assert page.evaluate("window.pressedAtOnce")
    _expect_unanswered(page)
    for box in page.evaluate(BOXES):
        for name in ("joystick", "joystick-turn", "stop"):
            assert not _overlap(box, _box(page, name)), f"it covers {name}"
    x, y = _centre(_box(page, "joystick"))
    for below in (0, 6, 60):
        assert page.evaluate(HIT, [x, y + below]) == "joystick"
    expect(question).to_have_attribute("data-deaf", "false")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 5)
    expect(question).to_have_attribute("data-deaf", "true")
    _press_answers(page)
    _expect_unanswered(page)
    page.mouse.up()
    expect(question).to_have_attribute("data-deaf", "false")
    expect_armed(page)
    page.keyboard.down("a")
    expect(question).to_have_attribute("data-deaf", "true")
    _press_answers(page)
    _expect_unanswered(page)
    page.keyboard.up("a")
    expect(question).to_have_attribute("data-deaf", "false")
    page.mouse.click(*_centre(_box(page, "hand-over")))
    expect_mode(page, "observe")
    expect(page.get_by_test_id("control-note")).to_contain_text("You no longer drive")

"""What comes up by itself while somebody drives is not answered by a slip; test_layout.py says where it comes up."""

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
PHONE = {"viewport": {"width": 844, "height": 390}, "has_touch": True, "is_mobile": True}
# A thumb that is already on its way presses in the moment in which the question comes up, whatever that is.
PRESS_AT_ONCE = """() => {
  const question = document.querySelector("[data-testid=question]");
  new MutationObserver(() => {
    if (question.hidden) return;
    for (const name of ["hand-over", "refuse"]) question.querySelector(`[data-testid=${name}]`).click();
    window.pressedAtOnce = true;
  }).observe(question, { attributes: true, attributeFilter: ["hidden"] });
}"""


@pytest.fixture
def asking(stack: Stack, browser: Browser) -> Iterator[Asking]:
    """Somebody new, as the server lets nobody ask again and again."""
    stack.wait_until_drivable(ROBOT)
    name = "bernd"
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


def _centre(box: FloatRect) -> tuple[float, float]:
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def _press_answers(page: Page) -> None:
    for name in ("hand-over", "refuse"):
        page.get_by_test_id(name).evaluate("button => button.click()")


def _expect_unanswered(page: Page) -> None:
    page.wait_for_timeout(300)
    expect_mode(page, "drive")
    expect(page.get_by_test_id("question")).to_be_visible()


@pytest.mark.parametrize("context", [PHONE], ids=["phone"], indirect=True)
def test_a_question_hears_no_slip(page: Page, stack: Stack, asking: Asking) -> None:
    """Deaf for its first 0.7 s and while stick or key is held; then a press hands over."""
    drive_live(page, stack, ROBOT)
    expect_armed(page)
    page.evaluate(PRESS_AT_ONCE)
    asking.ask()
    question = page.get_by_test_id("question")
    expect(question).to_contain_text(f"{asking.name} asks for control")
    assert page.evaluate("window.pressedAtOnce")
    _expect_unanswered(page)
    x, y = _centre(_box(page, "joystick"))
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
    expect(page.get_by_test_id("control-note")).to_contain_text("You handed control to")

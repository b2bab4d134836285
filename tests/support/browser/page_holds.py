"""Whether a page had to let go of what is held, because the machine delayed it or its video was late.

A page that did not look for a while may have missed a release, and one whose picture is too old shows nothing to drive
by; both let go, and whoever drives has to press anew. A test of what happens as long as something is held needs a
stretch of time without that: it looks, and takes another one if there was.

`hold` is that for anything that is pressed, `hold_key` for W, `drive` for W and a robot that has to move,
`release_stop` for the button that releases a stop.
"""

from __future__ import annotations

from collections.abc import Callable

from pages import expect_armed
from playwright.sync_api import Page, expect
from sim_watch import SimWatch

# As of gamepad.js, which looks in each frame; teleop.js, by its timer, waits 100 ms longer.
LOOK_MS = 250
# Time in which a page that holds its button has the robot released, or says why not: a second of holding, and the
# time limit of a request (api.js).
RELEASED_WITHIN_MS = 10_000
# Maximum number of presses that a busy machine may spoil one after the other.
MAX_PRESSES = 5

_NOTE = """() => {
  const state = document.querySelector('[data-testid=state]');
  // From the frame before on, in which the page looked last.
  let [last, longestMs, held] = [document.timeline.currentTime, 0, state.dataset.shown === 'held'];
  new MutationObserver(() => (held ||= state.dataset.shown === 'held'))
    .observe(state, {attributes: true, attributeFilter: ['data-shown']});
  const look = () => {
    const now = performance.now();
    [last, longestMs] = [now, Math.max(longestMs, now - last)];
  };
  const lookAtTimes = (due) => {
    longestMs = Math.max(longestMs, performance.now() - due);
    setTimeout(lookAtTimes, 50, performance.now() + 50);
  };
  lookAtTimes(performance.now());
  const lookInEachFrame = () => {
    look();
    requestAnimationFrame(lookInEachFrame);
  };
  requestAnimationFrame(lookInEachFrame);
  window.noted = () => {
    look();
    return {longestMs, held};
  };
}"""


def note(page: Page) -> None:
    page.evaluate(_NOTE)


def had_to_let_go(page: Page) -> bool:
    """Tell whether there was, since it was last begun to look, what makes a page let go."""
    noted = page.evaluate("window.noted()")
    return bool(noted["held"] or noted["longestMs"] > LOOK_MS)


def hold(
    page: Page,
    press: Callable[[], object],
    release: Callable[[], object],
    until: Callable[[], object],
    ready: Callable[[Page], object] = expect_armed,
) -> None:
    """Press what `ready` waits for until it has its effect, which `until` waits for; it stays pressed."""
    for _ in range(MAX_PRESSES):
        ready(page)
        note(page)
        press()
        try:
            until()
        except AssertionError:
            if not had_to_let_go(page):
                raise
            release()
        else:
            return
    raise AssertionError(f"the page let go of each of {MAX_PRESSES} presses")


def hold_key(page: Page, until: Callable[[], object]) -> None:
    hold(page, lambda: page.keyboard.down("w"), lambda: page.keyboard.up("w"), until)


def drive(page: Page, watch: SimWatch) -> None:
    hold_key(page, watch.wait_moving)


def release_stop(page: Page) -> None:
    """Hold the button that releases the robot until it is released, which takes a second of the page's own time."""
    button, bar = page.get_by_test_id("release"), page.get_by_test_id("stop-bar")

    def press() -> None:
        button.hover()
        page.mouse.down()

    hold(
        page,
        press,
        page.mouse.up,
        lambda: expect(bar).to_have_attribute("data-stop", "none", timeout=RELEASED_WITHIN_MS),
        lambda _: expect(button).to_be_visible(),
    )
    page.mouse.up()

"""Whether a page had to let go of what is held, because the machine delayed it or its video was late.

A page that did not look for a while may have missed a release, and one whose picture is too old shows nothing to drive
by; both let go, and whoever drives has to press anew. A test of what happens as long as something is held needs a
stretch of time without that: it looks, and takes another one if there was.

note(page)
hold something, and see what the robot does
if had_to_let_go(page): let go, and hold it once more
"""

from __future__ import annotations

from playwright.sync_api import Page

# As of gamepad.js, which looks in each frame; teleop.js, by its timer, waits 100 ms longer.
LOOK_MS = 250

_NOTE = """() => {
  const state = document.querySelector('[data-testid=state]');
  let [last, longestMs, held] = [performance.now(), 0, false];
  new MutationObserver(() => (held ||= state.dataset.shown === 'held'))
    .observe(state, {attributes: true, attributeFilter: ['data-shown']});
  const look = () => {
    const now = performance.now();
    [last, longestMs] = [now, Math.max(longestMs, now - last)];
  };
  const lookInEachFrame = () => {
    look();
    requestAnimationFrame(lookInEachFrame);
  };
  lookInEachFrame();
  window.noted = () => {
    look();
    return {longestMs, held};
  };
}"""


def note(page: Page) -> None:
    """Look from now on."""
    page.evaluate(_NOTE)


def had_to_let_go(page: Page) -> bool:
    """Tell whether there was, since it was last begun to look, what makes a page let go."""
    noted = page.evaluate("window.noted()")
    return bool(noted["held"] or noted["longestMs"] > LOOK_MS)

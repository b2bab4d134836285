"""A double of a gamepad: Chromium has no way to plug in one that is not there, so the page is given another list.

It behaves as Chromium's: a snapshot at each question, a timestamp that changes only with the device, an event when it
comes.
"""

from __future__ import annotations

from playwright.sync_api import Page

# As the standard mapping counts them.
LB, RB, B = 4, 5, 1
LEFT_X, LEFT_Y = 0, 1

_SCRIPT = """
{
  let pad = null;
  const copied = () => ({ ...pad, axes: [...pad.axes], buttons: pad.buttons.map((one) => ({ ...one })) });
  Object.defineProperty(navigator, "getGamepads", { value: () => [pad && copied(), null, null, null] });
  window.gamepadDouble = {
    plugIn() {
      const released = () => ({ pressed: false, touched: false, value: 0 });
      pad = { index: 0, id: "double", mapping: "standard", connected: true, timestamp: performance.now(),
        axes: Array(4).fill(0), buttons: Array.from({ length: 17 }, released) };
    },
    connect: () => dispatchEvent(new Event("gamepadconnected")),
    set(axes, pressed) {
      for (const [axis, value] of Object.entries(axes)) pad.axes[axis] = value;
      pad.buttons.forEach((one, i) => {
        one.pressed = pressed.includes(i);
        one.value = Number(one.pressed);
      });
      pad.timestamp = performance.now();
    },
    unplug: () => (pad = null),
  };
}
"""


class GamepadDouble:
    """What a person does with a gamepad; what it held stays as it was until it is changed."""

    def __init__(self, page: Page) -> None:
        """Give it to all documents that this page opens from now on."""
        self._page = page
        self._axes: dict[int, float] = {}
        self._pressed: set[int] = set()
        page.add_init_script(_SCRIPT)

    def plug_in(self) -> None:
        """Let the device be there, held as it was before."""
        self._page.evaluate("gamepadDouble.plugIn()")
        self._set()
        self._page.evaluate("gamepadDouble.connect()")

    def unplug(self) -> None:
        """Let it go without an event, as some do."""
        self._page.evaluate("gamepadDouble.unplug()")

    def press(self, *buttons: int) -> None:
        self._pressed.update(buttons)
        self._set()

    def release(self, *buttons: int) -> None:
        """Let go of these buttons; of all without any."""
        self._pressed -= set(buttons) or self._pressed
        self._set()

    def push(self, axis: int, value: float) -> None:
        self._axes[axis] = value
        self._set()

    def _set(self) -> None:
        axes = {str(axis): value for axis, value in self._axes.items()}
        self._page.evaluate(
            "([axes, pressed]) => gamepadDouble.set(axes, pressed)", [axes, sorted(self._pressed)]
        )

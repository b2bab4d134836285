"""A double of a gamepad: Chromium has no way to plug in one that is not there, so the page is given another list.

It behaves as Chromium's: a snapshot at each question, a timestamp that changes only with the device, an event when it
comes and one when it goes.
"""

from __future__ import annotations

from typing import Literal

from playwright.sync_api import Page

# As the standard mapping counts them.
LB, RB, B = 4, 5, 1
LEFT_X, LEFT_Y = 0, 1

Way = Literal["gone", "silently gone"]

_SCRIPT = """
{
  let pad = null;
  const copied = () => ({ ...pad, axes: [...pad.axes], buttons: pad.buttons.map((one) => ({ ...one })) });
  Object.defineProperty(navigator, "getGamepads", { value: () => [pad && copied(), null, null, null] });
  const tell = (name) => dispatchEvent(new Event(name));
  window.gamepadDouble = {
    plugIn(id, mapping, axes, buttons) {
      const released = () => ({ pressed: false, touched: false, value: 0 });
      pad = { index: 0, id, mapping, connected: true, timestamp: performance.now(),
        axes: Array(axes).fill(0), buttons: Array.from({ length: buttons }, released) };
    },
    connect: () => tell("gamepadconnected"),
    set(axes, pressed) {
      for (const [axis, value] of Object.entries(axes)) pad.axes[axis] = value;
      pad.buttons.forEach((one, i) => {
        one.pressed = pressed.includes(i);
        one.value = Number(one.pressed);
      });
      pad.timestamp = performance.now();
    },
    unplug(way) {
      pad = null;
      if (way === "gone") tell("gamepaddisconnected");
    },
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

    def plug_in(
        self, name: str = "double", *, mapping: str = "standard", axes: int = 4, buttons: int = 17
    ) -> None:
        """Let the device be there, held as it was before."""
        self._page.evaluate(
            "(device) => gamepadDouble.plugIn(...device)", [name, mapping, axes, buttons]
        )
        self._set()
        self._page.evaluate("gamepadDouble.connect()")

    def unplug(self, way: Way = "gone") -> None:
        """Let it go, with the browser's event or without."""
        self._page.evaluate("(way) => gamepadDouble.unplug(way)", way)

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

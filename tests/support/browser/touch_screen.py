"""Fingers on a touch screen, for tests of the drive page on a phone."""

from __future__ import annotations

from playwright.sync_api import Page


class TouchScreen:
    """Fingers on the screen, each on a stick; Chromium itself makes the events."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._devtools = page.context.new_cdp_session(page)
        self._points: dict[str, tuple[float, float]] = {}

    def put(self, stick: str, *, up: float, left: float) -> None:
        """Press the middle of a stick, unless this finger is on it already, and move there; 1 is at the rim."""
        box = self._page.get_by_test_id(stick).bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        if stick not in self._points:
            self._points[stick] = (x, y)
            self._send("touchStart", self._points)
        self._points[stick] = (x - left * box["width"] / 2, y - up * box["height"] / 2)
        self._send("touchMove", self._points)

    def lift(self, stick: str) -> None:
        """Take the finger from a stick; the others stay."""
        self._send("touchEnd", {stick: self._points.pop(stick)})

    def _send(self, kind: str, points: dict[str, tuple[float, float]]) -> None:
        touches = [{"x": x, "y": y, "id": sum(map(ord, stick))} for stick, (x, y) in points.items()]
        self._devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

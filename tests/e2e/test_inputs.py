"""What an operator holds drives only as long as the page can be sure that it is still meant.

Each test holds something in a real browser, takes the certainty away (a cut, a menu, a finger that lifts) and looks at
the robot itself: it stands, and it goes on only after a new press.
"""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import page_holds
import pytest
from pages import drive_live, expect_armed, expect_live, expect_mode
from playwright.sync_api import Page, expect
from sim_watch import SimWatch
from stack import Stack

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
ZERO = {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
STRETCHES = 5


@pytest.fixture(autouse=True)
def _drivable(stack: Stack) -> None:
    """The robots are there, and nobody else drives them, or the page would only watch."""
    for name in ("sim1", "sim2"):
        stack.wait_until_drivable(name)


@contextmanager
def _cut(page: Page, stack: Stack, sim: str) -> Iterator[None]:
    """Switch the robot off for the `with` block, and leave it when the page is live again."""
    stack.container(sim).stop(timeout=5)
    try:
        state = page.get_by_test_id("state")
        expect(state).not_to_have_attribute("data-state", "live", timeout=10_000)
        yield
    finally:
        stack.container(sim).start()
        stack.wait(f"{sim} online", lambda: stack.online(sim), sim, seconds=60)
    expect_live(page, seconds=30)


class Stick:
    """Where the joystick is on the screen, and the mouse that pushes it."""

    def __init__(self, page: Page) -> None:
        stick = page.get_by_test_id("joystick")
        stick.scroll_into_view_if_needed()
        box = stick.bounding_box()
        assert box is not None
        self.x = box["x"] + box["width"] / 2
        self.centre = box["y"] + box["height"] / 2
        self.forward = self.centre - box["height"] / 3
        self._mouse = page.mouse

    def push(self) -> None:
        """Press the stick with the mouse and drag it forward."""
        self._mouse.move(self.x, self.centre)
        self._mouse.down()
        self._mouse.move(self.x, self.forward, steps=4)

    def move_a_little(self, pixels: int) -> None:
        """Move the mouse without pressing or letting go."""
        self._mouse.move(self.x, self.forward + pixels)


def _moving(pose: dict[str, float]) -> bool:
    return pose["linear_velocity"] > 0.1


def _standing(pose: dict[str, float]) -> bool:
    return pose["linear_velocity"] == 0 and pose["angular_velocity"] == 0


def _assert_no_motion(
    watch: SimWatch, go_on: Callable[[int], None], since: float, seconds: float = 0.8
) -> None:
    """Nothing but zero reaches the wheels while the operator goes on (`go_on` gets 0, 1, 2 ...)."""
    end = time.monotonic() + seconds
    for step in itertools.count():
        go_on(step)
        moved = [seen.msg for seen in watch.commands(since) if seen.msg != ZERO]
        assert moved == [], f"the robot was driven by what was never pressed anew: {moved[:3]}"
        assert _standing(watch.pose)
        if time.monotonic() > end:
            return
        time.sleep(0.05)


def test_what_is_held_through_a_cut_moves_nothing_until_pressed_anew(
    page: Page, stack: Stack
) -> None:
    """Neither W, pressed before a cut, nor the stick, pressed during it, drives when the link is back."""
    drive_live(page, stack, "sim2")
    stick = Stick(page)

    def go_on(step: int) -> None:
        page.keyboard.down("w")  # of a key that is down, a repeat
        stick.move_a_little(step % 2)

    with SimWatch(stack, "sim2") as watch:
        page_holds.drive(page, watch)
    with _cut(page, stack, "sim2"):
        stick.push()
        go_on(0)
    with SimWatch(stack, "sim2") as watch:
        _assert_no_motion(watch, go_on, since=0)
        expect_armed(page)
        page.keyboard.down("d")
        watch.wait_pose("turning by D", lambda pose: pose["angular_velocity"] < 0)
        page.keyboard.up("d")
        watch.wait_pose("standing after D", _standing)
        _assert_no_motion(watch, go_on, since=time.monotonic())
        page.mouse.up()
        page.keyboard.up("w")
        page_holds.drive(page, watch)
        page.keyboard.up("w")
        watch.wait_pose("standing", _standing)
        expect_armed(page)
        stick.push()
        watch.wait_pose("moving by a new press of the stick", _moving)
        page.mouse.up()
        watch.wait_pose("standing", _standing)


def _right_click(page: Page) -> None:
    page.get_by_test_id("view").click(button="right", position={"x": 300, "y": 300})


def _drag_a_link(page: Page) -> None:
    box = page.get_by_role("link", name="Robots").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 60, box["y"] + 60, steps=4)
    page.mouse.up()


def _hold_control(page: Page) -> None:
    page.keyboard.down("Control")
    page.keyboard.up("Control")


def _open_a_list(page: Page) -> None:
    page.get_by_test_id("layout").click()


@pytest.mark.parametrize(
    "swallow",
    [_right_click, _drag_a_link, _hold_control, _open_a_list],
    ids=["context menu", "drag", "shortcut", "list"],
)
def test_what_may_swallow_the_release_stops_the_robot(
    page: Page, stack: Stack, swallow: Callable[[Page], None]
) -> None:
    """Where the browser may keep the keyup for itself W is let go, and its repeats do not drive on."""
    drive_live(page, stack, "sim1")
    with SimWatch(stack, "sim1") as watch:
        page_holds.drive(page, watch)
        swallow(page)
        watch.wait_pose("standing", _standing, seconds=1)
        _assert_no_motion(watch, lambda _: page.keyboard.down("w"), since=time.monotonic())
        page.keyboard.up("w")


def test_a_frozen_page_does_not_drive_on_when_it_thaws(page: Page, stack: Stack) -> None:
    """After two seconds in which the page ran no timer the robot stands, although W was never released."""
    drive_live(page, stack, "sim1")
    with SimWatch(stack, "sim1") as watch:
        page_holds.drive(page, watch)
        page.evaluate("{ const end = Date.now() + 2000; while (Date.now() < end); }")
        thawed = time.monotonic()
        watch.wait_pose("standing", _standing, seconds=1)
        _assert_no_motion(watch, lambda _: page.keyboard.down("w"), since=thawed)
        page.keyboard.up("w")


def _freeze(page: Page) -> None:
    """What a frozen tab, or a machine that hangs, is to its page: nothing runs for two seconds.

    The browser's own way to freeze a tab is only for those that nobody sees, which this one has to be.
    """
    assert page.context.browser is not None
    devtools = page.context.browser.new_browser_cdp_session()
    processes = devtools.send("SystemInfo.getProcessInfo")["processInfo"]
    pages = [process["id"] for process in processes if process["type"] == "renderer"]
    try:
        _send(pages, signal.SIGSTOP)
        time.sleep(2)  # how long it is frozen is the test's own matter
    finally:
        _send(pages, signal.SIGCONT)


def _send(pids: list[int], number: signal.Signals) -> None:
    """Send a signal to those that are still there: the page of the test before may just be ending."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def _throttle(page: Page) -> None:
    """What a browser does to a tab in the background: its timers run once a second."""
    page.evaluate(
        "{ const end = Date.now() + 3000;"
        "  const block = () => { const until = Date.now() + 900; while (Date.now() < until);"
        "    if (Date.now() < end) setTimeout(block, 1); }; block(); }"
    )


@pytest.mark.parametrize("slow", [_freeze, _throttle], ids=["frozen", "throttled"])
def test_a_tab_that_the_browser_slows_down_drives_no_more(
    page: Page, stack: Stack, slow: Callable[[Page], None]
) -> None:
    """The robot stands within a second, and W, which was never released, does not drive when the tab is awake."""
    drive_live(page, stack, "sim1")
    with SimWatch(stack, "sim1") as watch:
        page_holds.drive(page, watch)
        slow(page)
        watch.wait_pose("standing", _standing, seconds=1)
        _assert_no_motion(watch, lambda _: page.keyboard.down("w"), since=time.monotonic())
        page.keyboard.up("w")


def _wait_while_moving(watch: SimWatch, until: float) -> None:
    watch.wait_pose("held", lambda pose: time.monotonic() > until or not _moving(pose))


def finger_on(page: Page) -> Callable[..., None]:
    """Return what sends one kind of touch event, with the points at which fingers are."""
    touch = page.context.new_cdp_session(page)

    def finger(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y} for x, y in points]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    return finger


@pytest.mark.parametrize("context", [PHONE], indirect=True, ids=["phone"])
def test_button_that_appears_under_a_finger_takes_no_press(page: Page, stack: Stack) -> None:
    """Give up control comes where Hold to drive again was: neither the hold nor a press just after it gives up."""
    drive_live(page, stack, "sim1")
    page.get_by_test_id("stop").tap()
    release = page.get_by_test_id("release")
    expect(release).to_have_text("Hold to drive again")
    box = release.bounding_box()
    assert box is not None
    point = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    finger = finger_on(page)
    finger("touchStart", point)
    leave = page.get_by_test_id("control-leave")
    expect(leave).to_be_visible()
    under = page.evaluate("(at) => document.elementFromPoint(...at).dataset.testid", point)
    assert under == "control-leave"
    finger("touchEnd")
    finger("touchStart", point)
    finger("touchEnd")
    # A click comes before what the page does next.
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
    expect_mode(page, "drive")
    leave.click()
    expect_mode(page, "observe")


@pytest.mark.parametrize("context", [PHONE], indirect=True, ids=["phone"])
@pytest.mark.parametrize("end", ["touchEnd", "touchCancel"])
def test_a_finger_on_a_phone_drives_until_it_lifts(page: Page, stack: Stack, end: str) -> None:
    """A finger that holds the stick still goes on driving, past the time of a long press, and stops as it leaves."""
    drive_live(page, stack, "sim1")
    stick = Stick(page)
    finger = finger_on(page)
    with SimWatch(stack, "sim1") as watch:
        for _ in range(STRETCHES):
            expect_armed(page)
            finger("touchStart", (stick.x, stick.forward))
            watch.wait_pose("moving", _moving)
            page_holds.note(page)
            driven_until = time.monotonic() + 1.5
            _wait_while_moving(watch, driven_until)
            if not page_holds.had_to_let_go(page):
                break
            finger("touchEnd")
            watch.wait_pose("standing", _standing)
        else:
            raise AssertionError("the machine never let the page look for 1.5 seconds")
        assert _moving(watch.pose), "the robot stopped although the finger held the stick"
        finger("touchMove", (stick.x - 40, stick.forward))
        watch.wait_pose("turning left", lambda pose: pose["angular_velocity"] > 0.1)
        finger(end)
        watch.wait_pose("standing", _standing, seconds=1)
        _assert_no_motion(watch, lambda _: None, since=time.monotonic())

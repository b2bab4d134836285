"""Whatever a person drives with, the robot does what is held, and stands when it is let go or lost.

Gamepads are doubles (gamepad_double.py), fingers come from Chromium itself; the robot is looked at on its own
rosbridge.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import page_holds
import pytest
from gamepad_double import LB, LEFT_X, LEFT_Y, RB, RIGHT_X, B, GamepadDouble
from page_users import release_all
from pages import drive_live, expect_armed, expect_no_sideways_scroll, open_drawer
from playwright.sync_api import Page, expect
from sim_service import call_sim
from sim_watch import SimWatch
from stack import Stack
from stopwatch import Stopwatch

PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
ROBOT = "sim1"
PERIODS_PER_S = 20
# Of the machine's time: the page's zeros last 0.2 s and the guard's 0.5 s, some of them on a busy machine later.
LOOKED_AT_S, ZEROS_LAST_S, SILENT_S = 0.4, 0.9, 0.3
STRETCHES = 5


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


@pytest.fixture(autouse=True)
def _drivable(stack: Stack) -> None:
    """The robot is there, and nobody else drives it, or the page would only watch."""
    stack.wait_until_drivable(ROBOT)


@pytest.fixture
def gamepad(page: Page, stack: Stack) -> GamepadDouble:
    """A gamepad beside a page from which the robot can be driven, plugged in and at rest."""
    made = GamepadDouble(page)
    drive_live(page, stack, ROBOT)
    made.plug_in()
    _expect_gamepad(page, "ready")
    return made


@pytest.fixture
def watch(stack: Stack) -> Iterator[SimWatch]:
    """What the robot does."""
    with SimWatch(stack, ROBOT) as watching:
        yield watching


@contextmanager
def _robot_is(stack: Stack, kind: str) -> Iterator[None]:
    stack.admin.set_robot(ROBOT, {"page.kind": kind})
    try:
        yield
    finally:
        stack.admin.set_robot(ROBOT, {"page.kind": None})


def _expect_gamepad(page: Page, state: str) -> None:
    expect(page.get_by_test_id("gamepad")).to_have_attribute("data-state", state)


def _moving(pose: dict[str, float]) -> bool:
    return pose["linear_velocity"] > 0.1


def _standing(pose: dict[str, float]) -> bool:
    return pose["linear_velocity"] == 0 and pose["angular_velocity"] == 0


def _is_zero(twist: dict[str, Any]) -> bool:
    return not any((*twist["linear"].values(), *twist["angular"].values()))


def _stands(watch: SimWatch, for_s: float = LOOKED_AT_S) -> None:
    """Wait until the robot stands; then nothing but zero comes."""
    watch.wait_pose("standing", _standing, seconds=1)
    since = time.monotonic()
    with Stopwatch() as stopwatch:
        while stopwatch.s < for_s:
            moved = [seen.msg for seen in watch.commands(since) if not _is_zero(seen.msg)]
            assert moved == [], "it is driven by what nobody holds"
            time.sleep(0.05)


def _falls_silent(watch: SimWatch) -> None:
    """The robot stands, and soon not even zeros come."""
    _stands(watch, ZEROS_LAST_S)
    silent_from = time.monotonic()
    _stands(watch, SILENT_S)
    assert watch.commands(silent_from) == [], "the zeros do not end"


def _wait_command(
    watch: SimWatch, what: str, condition: Callable[[Any], bool], since: float = 0.0
) -> Any:
    """Wait for a command that is so, and return it; the robot may not move by it yet."""
    end = time.monotonic() + 5
    while True:
        sent = [seen.msg for seen in watch.commands(since)]
        if found := next((twist for twist in reversed(sent) if condition(twist)), None):
            return found
        assert time.monotonic() < end, f"no command {what}: {sent[-3:]}"
        time.sleep(0.02)


def _press_enable(page: Page, gamepad: GamepadDouble) -> None:
    """Press it when that counts: pressed while a late picture holds driving, it would be stuck."""
    _expect_gamepad(page, "ready")
    gamepad.press(LB)


def _drive(page: Page, gamepad: GamepadDouble, watch: SimWatch) -> None:
    gamepad.push(LEFT_Y, -1)
    _press_enable(page, gamepad)
    watch.wait_pose("moving by the gamepad", _moving)


def _stays_until_pressed_anew(page: Page, gamepad: GamepadDouble, watch: SimWatch) -> None:
    _stands(watch)
    _expect_gamepad(page, "stuck")
    gamepad.release(LB)
    _press_enable(page, gamepad)
    watch.wait_pose("moving by a new press", _moving)
    gamepad.release(LB)
    _stands(watch)


def test_a_gamepad_drives_while_its_button_is_held(
    page: Page, gamepad: GamepadDouble, watch: SimWatch
) -> None:
    """The stick alone moves nothing; with the button it drives 20 times a second; without, zero and silence."""
    gamepad.push(LEFT_Y, -1)
    _stands(watch)
    for _ in range(STRETCHES):
        gamepad.push(LEFT_X, 0)
        _press_enable(page, gamepad)
        watch.wait_pose("moving", _moving)
        page_holds.note(page)
        since = time.monotonic()
        with Stopwatch() as stopwatch:
            gamepad.push(LEFT_X, -1)
            page.wait_for_timeout(2000)
            sent = watch.commands(since)
        if not page_holds.had_to_let_go(page):
            break
        gamepad.release(LB)
    else:
        raise AssertionError("the machine never let the page look for two seconds")
    watch.wait_seen("turning left", lambda pose: pose["angular_velocity"] > 0.1, since)
    assert len(sent) / stopwatch.s > PERIODS_PER_S * 0.7
    # Some of before may come late, too.
    assert len(sent) / (sent[-1].at - since) < PERIODS_PER_S * 1.3
    gamepad.release(LB)
    _falls_silent(watch)


def test_turbo_goes_beyond_the_sliders_but_not_beyond_the_robots_limit(
    page: Page, gamepad: GamepadDouble, watch: SimWatch
) -> None:
    """With the slider down the robot is slow; with turbo as fast as it may; and slow again."""
    open_drawer(page)
    slider = page.get_by_test_id("limit-linear")
    most = float(slider.get_attribute("max") or "nan")
    slider.press("Home")
    least = float(slider.input_value())
    assert least < most

    def drives_at(speed: float) -> None:
        watch.wait_pose(
            f"driving at {speed} m/s", lambda pose: abs(pose["linear_velocity"] - speed) < 1e-3
        )

    gamepad.push(LEFT_Y, -1)
    _press_enable(page, gamepad)
    drives_at(least)
    gamepad.press(RB)
    drives_at(most)
    gamepad.release(RB)
    drives_at(least)
    gamepad.release(LB)
    _stands(watch)


def test_shift_is_faster_and_x_slower_as_long_as_they_are_held(
    page: Page, stack: Stack, watch: SimWatch
) -> None:
    """By a step each; the knob and the caps of the keys show what is held, and after all is let go nothing drives."""
    drive_live(page, stack, ROBOT)
    call_sim(stack, ROBOT, "/reset")
    most = float(page.get_by_test_id("limit-linear").get_attribute("max") or "nan")

    def drives_at(share: float) -> None:
        watch.wait_pose(
            f"driving at {share} of its speed",
            lambda pose: abs(abs(pose["linear_velocity"]) - share * most) < 1e-3,
        )

    expect_armed(page)
    page.keyboard.down("w")
    drives_at(0.6)
    expect(page.locator("[data-key=KeyW]")).to_have_attribute("data-lit", "true")
    knob = page.get_by_test_id("joystick").locator("[data-part=knob]")
    assert "translate" in (knob.get_attribute("style") or "")
    page.keyboard.down("Shift")
    drives_at(1)
    page.keyboard.up("Shift")
    page.keyboard.down("x")
    drives_at(0.3)
    page.keyboard.up("x")
    drives_at(0.6)
    page.keyboard.up("w")
    _stands(watch)
    expect(page.locator("[data-lit=true]")).to_have_count(0)
    page.get_by_test_id("speed-slow").click()
    expect_armed(page)
    page.keyboard.down("s")
    drives_at(0.3)
    page.keyboard.up("s")
    _stands(watch)


def test_a_lost_gamepad_stops_the_robot(
    page: Page, gamepad: GamepadDouble, watch: SimWatch
) -> None:
    """The robot stands, the page says so, and the same gamepad, still held, does not drive when it is back."""
    _drive(page, gamepad, watch)
    gamepad.unplug("silently gone")
    watch.wait_pose("standing", _standing, seconds=1)
    _expect_gamepad(page, "lost")
    gamepad.plug_in()
    _stays_until_pressed_anew(page, gamepad, watch)


def test_a_gamepad_drives_no_page_that_was_frozen(
    page: Page, gamepad: GamepadDouble, watch: SimWatch
) -> None:
    """What is held when the page freezes counts only after a new press."""
    _drive(page, gamepad, watch)
    page.evaluate("{ const end = Date.now() + 2000; while (Date.now() < end); }")
    _stays_until_pressed_anew(page, gamepad, watch)


def test_a_gamepad_drives_no_page_without_the_focus(
    page: Page, gamepad: GamepadDouble, watch: SimWatch
) -> None:
    """Browsers show gamepads to a page behind another window too: there, a new press drives nothing."""
    page.evaluate("document.hasFocus = () => false; dispatchEvent(new Event('blur'))")
    gamepad.push(LEFT_Y, -1)
    gamepad.press(LB)
    _expect_gamepad(page, "off")
    _stands(watch)
    page.evaluate("delete document.hasFocus")
    _stays_until_pressed_anew(page, gamepad, watch)


def test_the_gamepads_stop_button_stops(
    page: Page, gamepad: GamepadDouble, watch: SimWatch, stack: Stack
) -> None:
    """In mid-drive it is a Stop as any other: it holds until somebody releases the robot."""
    _drive(page, gamepad, watch)
    try:
        gamepad.press(B)
        watch.wait_pose("standing", _standing, seconds=1)
        expect(page.get_by_test_id("stop-bar")).to_have_attribute("data-stop", "stopped")
        _stands(watch)
    finally:
        release_all(stack, [ROBOT])


def test_an_unknown_gamepad_is_learnt_by_moving_it_and_kept_for_this_device(
    page: Page, stack: Stack, watch: SimWatch
) -> None:
    """It drives nothing before, drives as it was shown, also after a reload, and not with another number of axes."""
    device = {"mapping": "", "axes": 3, "buttons": 6}
    gamepad = GamepadDouble(page)
    drive_live(page, stack, ROBOT)
    gamepad.plug_in("unknown", **device)
    _expect_gamepad(page, "unknown")
    open_drawer(page)
    page.get_by_test_id("gamepad-open").click()
    page.get_by_test_id("gamepad-learn").click()
    ask = page.get_by_test_id("gamepad-ask")

    def show(asked: str, act: Callable[[], None], back: Callable[[], None]) -> None:
        expect(ask).to_contain_text(asked)
        act()
        expect(ask).to_contain_text("Let go of it")
        back()

    show("drives forward", lambda: gamepad.push(2, 1), lambda: gamepad.push(2, 0))
    show("turns to the left", lambda: gamepad.push(0, -1), lambda: gamepad.push(0, 0))
    show("hold to drive", lambda: gamepad.press(3), gamepad.release)
    page.get_by_test_id("gamepad-pass").click()
    show("stops the robot", lambda: gamepad.press(5), gamepad.release)
    _expect_gamepad(page, "ready")
    for _ in range(2):
        gamepad.push(2, 1)
        gamepad.press(3)
        watch.wait_pose("moving as it was shown", _moving)
        gamepad.release()
        gamepad.push(2, 0)
        _stands(watch)
        drive_live(page, stack, ROBOT)
        gamepad.plug_in("unknown", **device)
        _expect_gamepad(page, "ready")
    gamepad.unplug()
    gamepad.plug_in("unknown", **{**device, "axes": 4})
    _expect_gamepad(page, "unknown")
    gamepad.unplug()
    gamepad.plug_in("unknown", **device)
    open_drawer(page)
    page.get_by_test_id("gamepad-open").click()
    page.get_by_test_id("gamepad-forget").click()
    _expect_gamepad(page, "unknown")


def _choose_two_sticks(page: Page) -> None:
    open_drawer(page)
    page.get_by_test_id("two-sticks").click()
    expect(page.get_by_test_id("joystick-turn")).to_be_visible()
    page.get_by_test_id("joystick-turn").scroll_into_view_if_needed()
    expect_armed(page)


@pytest.mark.parametrize("context", [PHONE], indirect=True, ids=["phone"])
def test_two_thumbs_drive_on_a_phone(page: Page, stack: Stack, watch: SimWatch) -> None:
    """The left one goes, the right one turns; each that lifts ends its own; the choice is there after a reload."""
    drive_live(page, stack, ROBOT)
    _choose_two_sticks(page)
    expect_no_sideways_scroll(page)
    touch_screen = TouchScreen(page)
    touch_screen.put("joystick", up=0.9, left=0.5)
    watch.wait_pose("going straight", lambda pose: _moving(pose) and pose["angular_velocity"] == 0)
    touch_screen.put("joystick-turn", up=0.5, left=0.9)
    watch.wait_pose(
        "turning as it goes", lambda pose: _moving(pose) and pose["angular_velocity"] > 0.1
    )
    touch_screen.lift("joystick")
    watch.wait_pose(
        "turning on the spot",
        lambda pose: pose["linear_velocity"] == 0 and pose["angular_velocity"] > 0.1,
    )
    touch_screen.lift("joystick-turn")
    _stands(watch)
    drive_live(page, stack, ROBOT)
    expect(page.get_by_test_id("joystick-turn")).to_be_visible()


def test_the_mouse_turns_the_robot_with_the_right_stick(
    page: Page, stack: Stack, watch: SimWatch
) -> None:
    """However it is dragged, the right stick only turns."""
    drive_live(page, stack, ROBOT)
    _choose_two_sticks(page)
    box = page.get_by_test_id("joystick-turn").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + box["width"] / 3, y - box["height"] / 3, steps=4)
    watch.wait_pose("turning right", lambda pose: pose["angular_velocity"] < -0.1)
    assert all(seen.msg["linear"]["x"] == 0 for seen in watch.commands())
    page.mouse.up()
    _stands(watch)


def test_keys_go_sideways_on_a_robot_that_can(page: Page, stack: Stack, watch: SimWatch) -> None:
    """Q is left and E right, with two sticks at hand from the beginning."""
    with _robot_is(stack, "holonomic"):
        drive_live(page, stack, ROBOT)
        expect(page.get_by_test_id("joystick-turn")).to_be_visible()
        for key, sign in (("q", 1), ("e", -1)):
            expect_armed(page)
            pressed = time.monotonic()
            page.keyboard.down(key)
            sent = _wait_command(
                watch, f"sideways by {key}", lambda twist: twist["linear"]["y"] != 0, pressed
            )
            assert sent["linear"]["y"] * sign > 0, key
            assert sent["linear"]["x"] == sent["angular"]["z"] == 0, key
            released = time.monotonic()
            page.keyboard.up(key)
            # As seen from outside, this robot stands all the time.
            _wait_command(watch, "to stand", _is_zero, released)
            _stands(watch)


def test_a_gamepad_goes_sideways_and_turns_on_a_robot_that_can(
    page: Page, stack: Stack, watch: SimWatch
) -> None:
    """The left stick goes any way, no faster along a diagonal, and the right one turns."""
    with _robot_is(stack, "holonomic"):
        gamepad = GamepadDouble(page)
        drive_live(page, stack, ROBOT)
        gamepad.plug_in()
        _expect_gamepad(page, "ready")
        gamepad.push(LEFT_X, -1)
        gamepad.push(LEFT_Y, -1)
        gamepad.push(RIGHT_X, 1)
        gamepad.press(LB)
        sent = _wait_command(watch, "that turns", lambda twist: twist["angular"]["z"] < 0)
        most = float(page.get_by_test_id("limit-linear").input_value())
        assert sent["linear"]["x"] ** 2 + sent["linear"]["y"] ** 2 == pytest.approx(most**2)
        assert sent["linear"]["x"] == pytest.approx(sent["linear"]["y"])
        watch.wait_pose("turning as it goes", lambda pose: pose["angular_velocity"] < 0)
        gamepad.release()
        _stands(watch)


def test_a_car_does_not_turn_in_place(page: Page, stack: Stack, watch: SimWatch) -> None:
    """A alone asks for nothing; with S too the robot backs and turns the other way."""
    with _robot_is(stack, "ackermann"):
        drive_live(page, stack, ROBOT)
        expect_armed(page)
        page.keyboard.down("a")
        _wait_command(watch, "at all", lambda _: True)
        assert all(_is_zero(seen.msg) for seen in watch.commands())
        page.keyboard.down("s")
        sent = _wait_command(watch, "that backs", lambda twist: twist["linear"]["x"] < 0)
        assert sent["angular"]["z"] < 0
        watch.wait_pose("backing", _moving)
        page.keyboard.up("s")
        page.keyboard.up("a")
        _stands(watch)


def test_what_is_said_of_a_gamepad_does_not_move_the_stick(
    page: Page, gamepad: GamepadDouble
) -> None:
    """A gamepad that comes or goes, and its words, move the joystick by no pixel."""
    stick = page.get_by_test_id("joystick")
    before = stick.bounding_box()
    gamepad.unplug()
    _expect_gamepad(page, "lost")
    assert stick.bounding_box() == before
    gamepad.plug_in("another", mapping="", axes=9)
    _expect_gamepad(page, "unknown")
    assert stick.bounding_box() == before

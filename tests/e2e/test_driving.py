"""Whatever a person drives with, the robot does what is held, and stands when it is let go or lost.

Gamepads are doubles, fingers come from Chromium itself; the robot is looked at on its own
rosbridge. What each input makes of its events are unit tests of the scripts in `input/`.
"""

import os
import signal
import time
from contextlib import suppress

import page_holds
import pytest
from page_users import release_all
from pages import (
    drive_live,
    expect_armed,
    expect_live,
    expect_mode,
    expect_no_sideways_scroll,
    open_drawer,
    open_robot,
)
from playwright.sync_api import expect
from sim_watch import SimWatch

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
    """A gamepad that is not there: the page is given another list, which behaves as Chromium's.

    What it held stays as it was until it is changed.
    """

    def __init__(self, page):
        """Give it to all documents that this page opens from now on."""
        self._page = page
        self._axes = {}
        self._pressed = set()
        page.add_init_script(_SCRIPT)

    def plug_in(self):
        """Let the device be there, held as it was before."""
        self._page.evaluate("gamepadDouble.plugIn()")
        self._set()
        self._page.evaluate("gamepadDouble.connect()")

    def unplug(self):
        """Let it go without an event, as some do."""
        self._page.evaluate("gamepadDouble.unplug()")

    def press(self, *buttons):
        self._pressed.update(buttons)
        self._set()

    def release(self, *buttons):
        """Let go of these buttons; of all without any."""
        self._pressed -= set(buttons) or self._pressed
        self._set()

    def push(self, axis, value):
        self._axes[axis] = value
        self._set()

    def _set(self):
        axes = {str(axis): value for axis, value in self._axes.items()}
        self._page.evaluate(
            "([axes, pressed]) => gamepadDouble.set(axes, pressed)", [axes, sorted(self._pressed)]
        )


PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
ROBOT = "sim1"


class TouchScreen:
    """Fingers on the screen; Chromium itself makes the events."""

    def __init__(self, page):
        self._page = page
        self._devtools = page.context.new_cdp_session(page)
        self._points = {}

    def put(self, name, *, up=0, left=0):
        """Press the middle of a thing, unless this finger is on it already, and move there; 1 is at the rim."""
        box = self._page.get_by_test_id(name).bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        if name not in self._points:
            self._points[name] = (x, y)
            self._send("touchStart", self._points)
        self._points[name] = (x - left * box["width"] / 2, y - up * box["height"] / 2)
        self._send("touchMove", self._points)

    def lift(self, name):
        """Take the finger from a thing, and return where it was; the others stay."""
        point = self._points.pop(name)
        self._send("touchEnd", {name: point})
        return point

    def lift_all(self):
        for name in list(self._points):
            self.lift(name)

    def tap(self, point):
        self._send("touchStart", {"tap": point})
        self._send("touchEnd", {"tap": point})

    def _send(self, kind, points):
        touches = [{"x": x, "y": y, "id": sum(map(ord, name))} for name, (x, y) in points.items()]
        self._devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})


@pytest.fixture(autouse=True)
def _drivable(stack):
    stack.wait_until_drivable(ROBOT)


@pytest.fixture
def watch(stack):
    with SimWatch(stack, ROBOT) as watching:
        yield watching


def _expect_gamepad(page, state):
    expect(page.get_by_test_id("gamepad")).to_have_attribute("data-state", state)


def _moving(pose):
    return pose["linear_velocity"] > 0.1


def _turning(pose):
    return pose["angular_velocity"] > 0.1


def _is_zero(twist):
    return not any((*twist["linear"].values(), *twist["angular"].values()))


def _falls_silent(watch):
    """The robot stands, nothing but zero comes any more, and soon not even that."""
    watch.wait_standing()
    # A robot that stands all the time says nothing of what is under way.
    watch.wait_pose(
        "told to stop", lambda _: all(_is_zero(seen.msg) for seen in watch.commands()[-1:])
    )
    since = time.monotonic()
    watch.wait_pose(
        "silent",
        lambda _: (
            time.monotonic() - max([since, *(command.at for command in watch.commands())]) > 0.5
        ),
    )
    assert all(_is_zero(seen.msg) for seen in watch.commands(since))


def _repeat(page, watch):
    """A key that is still down repeats, and drives nothing until it is pressed anew."""
    since = time.monotonic()
    page.keyboard.down("w")
    expect_armed(page)
    time.sleep(0.3)  # in which a command would have come
    assert all(_is_zero(seen.msg) for seen in watch.commands(since))
    page.keyboard.up("w")
    page_holds.drive(page, watch)
    page.keyboard.up("w")
    watch.wait_standing()


def _press_enable(page, gamepad, until):
    """Press it when that counts: pressed while a late picture holds driving, it would be stuck."""
    page_holds.hold(
        page,
        lambda: gamepad.press(LB),
        gamepad.release,
        until,
        lambda page: _expect_gamepad(page, "ready"),
    )


def test_keys_and_mouse_drive_until_they_are_let_go(page, stack, watch):
    """W drives at the chosen speed, with Shift faster; the stick goes in a curve; afterwards nothing is sent."""
    open_robot(page, stack, ROBOT)
    page.get_by_test_id("control-drive").click()
    expect_mode(page, "drive")
    most = float(page.get_by_test_id("limit-linear").get_attribute("max") or "nan")

    def goes_as_fast_as_it_may():
        watch.wait_moving()
        expect(page.get_by_test_id("speed-linear")).to_contain_text("m/s")
        expect(page.locator("[data-key=KeyW]")).to_have_attribute("data-lit", "true")
        page.keyboard.down("Shift")
        watch.wait_pose("faster", lambda pose: abs(pose["linear_velocity"] - most) < 1e-3)

    def release():
        page.keyboard.up("Shift")
        page.keyboard.up("w")

    page_holds.hold(page, lambda: page.keyboard.down("w"), release, goes_as_fast_as_it_may)
    release()
    expect(page.locator("[data-lit=true]")).to_have_count(0)
    _falls_silent(watch)
    box = page.get_by_test_id("joystick").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag():
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - box["width"] / 6, y - box["height"] / 3, steps=4)

    page_holds.hold(
        page,
        drag,
        page.mouse.up,
        lambda: watch.wait_pose("in a curve", lambda pose: _moving(pose) and _turning(pose)),
    )
    page.mouse.up()
    _falls_silent(watch)


LOSSES = {
    "a window without the focus": "dispatchEvent(new Event('blur'))",
    "a page that runs nothing for two seconds": "{ const end = Date.now() + 2000; while (Date.now() < end); }",
}


def test_a_key_whose_release_may_be_lost_is_let_go(page, stack, watch):
    drive_live(page, stack, ROBOT)

    def loses(what):
        if what in LOSSES:
            page.evaluate(LOSSES[what])
        elif what == "context menu":
            page.get_by_test_id("view").click(button="right", position={"x": 300, "y": 300})
        elif what == "list":
            page.get_by_test_id("layout").click()
        elif what == "fullscreen":
            page.keyboard.press("f")
        else:
            _freeze(page)

    for what in (*LOSSES, "context menu", "list", "fullscreen", "stopped process"):
        page_holds.drive(page, watch)
        loses(what)
        watch.wait_standing(f"standing after {what}")
        if what == "list":
            page.keyboard.press("Escape")
        _repeat(page, watch)
    page.wait_for_function("() => document.fullscreenElement")
    for name in ("stop", "joystick", "stage", "control"):
        expect(page.get_by_test_id(name)).to_be_in_viewport(ratio=0.9)


def _freeze(page):
    """What a frozen tab, or a machine that hangs, is to its page: nothing runs for two seconds.

    The browser's own way to freeze a tab is only for those that nobody sees, which this one has to be.
    """
    devtools = page.context.browser.new_browser_cdp_session()
    found = devtools.send("SystemInfo.getProcessInfo")["processInfo"]
    pages = [process["id"] for process in found if process["type"] == "renderer"]
    try:
        _send(pages, signal.SIGSTOP)
        time.sleep(2)  # how long it is frozen is the test's own matter
    finally:
        _send(pages, signal.SIGCONT)


def _send(pids, number):
    """Send a signal to those that are still there: the page of the test before may just be ending."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def test_what_is_held_through_a_loss_of_power_moves_nothing_until_pressed_anew(page, stack):
    """The page says that the robot is offline and comes back with it, without a reload, as its card does."""
    sim = stack.container("sim2")
    fleet = page.context.new_page()
    fleet.goto(f"{stack.url}/")
    card = fleet.get_by_test_id("robot-card-sim2")
    stack.wait_until_drivable("sim2")
    drive_live(page, stack, "sim2")
    page.bring_to_front()
    page.evaluate("window.sameDocument = true")
    with SimWatch(stack, "sim2") as watch:
        page_holds.drive(page, watch)
    expect(card).to_have_attribute("data-online", "true")
    sim.kill()
    try:
        expect(card).to_have_attribute("data-online", "false", timeout=30_000)
        state = page.get_by_test_id("state")
        expect(state).to_have_attribute("data-shown", "offline", timeout=30_000)
        expect(state).to_contain_text("This page connects by itself when the robot is back.")
    finally:
        sim.start()
        stack.wait("sim2 online", lambda: stack.online("sim2"), "sim2", seconds=60)
    expect_live(page, seconds=40)
    expect(card).to_have_attribute("data-online", "true")
    assert page.evaluate("window.sameDocument") is True
    with SimWatch(stack, "sim2") as watch:
        _repeat(page, watch)


def test_a_gamepad_drives_while_its_button_is_held(page, stack, watch):
    """Turbo is faster; a gamepad that disconnects stops the robot and moves nothing else; its stop button is a Stop."""
    gamepad = GamepadDouble(page)
    drive_live(page, stack, ROBOT)
    gamepad.plug_in()
    stick = page.get_by_test_id("joystick").bounding_box()
    open_drawer(page)
    slider = page.get_by_test_id("limit-linear")
    slider.press("Home")
    least, most = float(slider.input_value()), float(slider.get_attribute("max") or "nan")
    gamepad.push(LEFT_Y, -1)

    def drives_at(speed):
        watch.wait_pose(
            f"driving at {speed} m/s", lambda pose: abs(pose["linear_velocity"] - speed) < 1e-3
        )

    def drives_faster_with_turbo():
        drives_at(least)
        gamepad.press(RB)
        drives_at(most)

    _press_enable(page, gamepad, drives_faster_with_turbo)
    gamepad.release()
    _falls_silent(watch)
    gamepad.push(LEFT_X, -1)
    _press_enable(page, gamepad, lambda: watch.wait_pose("turning left", _turning))
    gamepad.unplug()
    watch.wait_standing()
    _expect_gamepad(page, "lost")
    assert page.get_by_test_id("joystick").bounding_box() == stick
    gamepad.plug_in()
    _expect_gamepad(page, "stuck")
    gamepad.release(LB)
    _expect_gamepad(page, "uncentred")
    gamepad.push(LEFT_Y, 0)
    gamepad.push(LEFT_X, 0)
    _expect_gamepad(page, "ready")
    gamepad.push(LEFT_X, -1)
    _press_enable(page, gamepad, lambda: watch.wait_pose("turning by a new press", _turning))
    try:
        gamepad.press(B)
        watch.wait_standing()
        expect(page.get_by_test_id("stop-bar")).to_have_attribute("data-stop", "stopped")
    finally:
        release_all(stack, [ROBOT])


@pytest.mark.parametrize("context", [PHONE], indirect=True, ids=["phone"])
def test_two_thumbs_drive_on_a_phone_and_a_button_under_a_finger_takes_no_press(page, stack, watch):
    """Left goes, right turns, each that lifts ends its own; a hold of Drive again gives nothing up as it ends."""
    drive_live(page, stack, ROBOT)
    open_drawer(page)
    page.get_by_test_id("two-sticks").click()
    page.get_by_test_id("joystick-turn").scroll_into_view_if_needed()
    expect_armed(page)
    expect_no_sideways_scroll(page)
    fingers = TouchScreen(page)

    def each_thumb_counts():
        watch.wait_pose("straight", lambda pose: _moving(pose) and pose["angular_velocity"] == 0)
        fingers.put("joystick-turn", up=0.5, left=0.9)
        watch.wait_pose("turning as it goes", lambda pose: _moving(pose) and _turning(pose))
        fingers.lift("joystick")
        watch.wait_pose("on the spot", lambda pose: pose["linear_velocity"] == 0 and _turning(pose))

    page_holds.hold(
        page,
        lambda: fingers.put("joystick", up=0.9, left=0.5),
        fingers.lift_all,
        each_thumb_counts,
    )
    fingers.lift_all()
    _falls_silent(watch)
    page.get_by_test_id("drawer-open").click()
    try:
        for _ in range(page_holds.MAX_PRESSES):
            point = _drive_again_by_thumb(page, fingers)
            if _tap_at_once(page, fingers, point):
                break
            drive_live(page, stack, ROBOT)
        else:
            raise AssertionError("the machine was late at each tap")
        # A click comes before what the page does next.
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
        expect(page.get_by_test_id("control")).to_have_attribute("data-mode", "drive")
        under = page.evaluate("(at) => document.elementFromPoint(...at).dataset.testid", point)
        assert under == "control-leave"
        _assert_two_fingers_zoom_nothing(page, fingers)
    finally:
        release_all(stack, [ROBOT])


def _assert_two_fingers_zoom_nothing(page, fingers):
    """Stop would no longer be where it was."""
    for name, up in [("speed-slow", 0), ("speed-fast", -3), ("speed-slow", 5), ("speed-slow", 6)]:
        fingers.put(name, up=up)
    assert page.evaluate("visualViewport.scale") == 1
    fingers.lift_all()


def _drive_again_by_thumb(page, fingers):
    """Stop the robot, and hold its release until the page drives again; gives where the thumb was."""
    page.get_by_test_id("stop").tap()
    page_holds.hold(
        page,
        lambda: fingers.put("release"),
        lambda: fingers.lift("release"),
        lambda: expect(page.get_by_test_id("control-leave")).to_be_visible(),
        lambda page: expect(page.get_by_test_id("release")).to_have_text("Hold to drive again"),
    )
    return fingers.lift("release")


def _tap_at_once(page, fingers, point):
    """Tap what is new there; false if a busy machine was late, so that it may be new no more and the tap may count."""
    fingers.tap(point)
    return page.get_by_test_id("control-leave").get_attribute("aria-disabled") == "true"


def test_a_driver_without_network_reads_that_and_nothing_drives_on(page, stack, watch):
    """A stop meanwhile is said to be unheard, and heard when the network is back."""
    drive_live(page, stack, ROBOT)
    state, bar = page.get_by_test_id("state"), page.get_by_test_id("stop-bar")
    page_holds.drive(page, watch)
    page.context.set_offline(True)
    watch.wait_standing()
    expect(state).to_have_attribute("data-shown", "server_unreachable", timeout=20_000)
    expect(state).to_contain_text("Check this device's network")
    page.context.set_offline(False)
    expect_live(page, seconds=20)
    _repeat(page, watch)
    page.context.set_offline(True)
    expect(state).not_to_have_attribute("data-state", "live")
    try:
        page.keyboard.press("Space")
        expect(bar).to_have_attribute("data-stop", "unheard")
        page.context.set_offline(False)
        expect(bar).to_have_attribute("data-stop", "stopped")
    finally:
        release_all(stack, [ROBOT])

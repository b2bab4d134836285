"""Two people and one robot: who drives, who asks, and how the control goes from page to page.

Each person has a browser of their own, in front of the whole stack.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import closing

import page_holds
import pytest
from gamepad_double import LB, LEFT_Y, GamepadDouble
from page_users import PageUsers
from pages import answer, expect_armed, expect_live, expect_mode, take_control, wait_until
from playwright.sync_api import Browser, Page, Route, expect
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim1"
# As of teleop.js, less what a machine may need to tell of it.
TAKE_MS = 900
STRETCHES = 5
# How long it took from a moment before the press until what is pressed counts.
NOTE_TAKING = """() => {
  const stick = document.querySelector("[data-testid=joystick]");
  new MutationObserver(() => {
    if (stick.dataset.armed === "true") window.takenMs = performance.now() - window.pressedAt;
  }).observe(stick, { attributes: true, attributeFilter: ["data-armed"] });
}"""


@pytest.fixture
def page_users(stack: Stack, browser: Browser) -> Iterator[PageUsers]:
    """Ann and Ben, who may drive, and Olga, who may watch; nobody drives yet."""
    stack.wait_until_drivable(ROBOT)
    with closing(PageUsers(stack, browser)) as people:
        for name, level in (("ann", "drive"), ("ben", "drive"), ("olga", "observe")):
            people.let(name, level, ROBOT)
        yield people


@pytest.fixture
def usual_policy(stack: Stack) -> Iterator[None]:
    """The test may change the number of subscriptions, which is the usual one again for those that follow."""
    yield
    stack.admin.set_robot(ROBOT, {"policy.limits.subscriptions": None})
    stack.wait_for_changes(ROBOT)


@pytest.fixture
def ann(page_users: PageUsers) -> Page:
    """Ann's page: she drives."""
    page = page_users.drive("ann", ROBOT)
    expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")
    return page


@pytest.fixture
def ben(page_users: PageUsers, ann: Page) -> Page:
    """Ben's page, which watches."""
    page = page_users.open("ben", ROBOT)
    expect_mode(page, "observe")
    return page


def _ask(asking: Page, asked: Page) -> None:
    asking.get_by_test_id("control-ask").click()
    expect(asked.get_by_test_id("question")).to_be_visible()
    expect(asked.get_by_test_id("question")).to_contain_text("ben asks for control")


def _assert_drives_only_after_a_word(page: Page, stack: Stack) -> None:
    """Control that came by itself moves nothing until the person begins."""
    with SimWatch(stack, ROBOT) as watch:
        page.keyboard.press("w", delay=500)
        assert [seen for seen in watch.commands() if seen.msg["linear"]["x"] != 0] == []
        page.get_by_test_id("control-arm").click()
        page_holds.drive(page, watch)
        page.keyboard.up("w")
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)


def test_the_second_one_watches_and_reads_who_drives(
    page_users: PageUsers, ann: Page, ben: Page
) -> None:
    """Who comes second reads who drives since when and may ask; who may only watch reads the same."""
    drives = re.compile(r"ann is driving \(since \d\d:\d\d\)")
    expect(ben.get_by_test_id("driver")).to_have_text(drives)
    expect(ben.get_by_test_id("control-ask")).to_be_visible()
    expect(ben.get_by_test_id("control-take")).to_be_hidden()
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    olga = page_users.open("olga", ROBOT)
    expect(olga.get_by_test_id("driver")).to_have_text(drives)
    expect(olga.get_by_test_id("control-ask")).to_be_hidden()
    expect(ann.get_by_test_id("driver")).to_contain_text("You are driving")
    expect(ann.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")


def test_the_driver_hands_over(ann: Page, ben: Page, stack: Stack) -> None:
    """The control comes to who asked, without a further press, and drives only after one."""
    _ask(ben, ann)
    expect(ben.get_by_test_id("control-left")).to_contain_text("You asked ann")
    answer(ann, "hand-over")
    expect_mode(ben, "drive")
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("control-note")).to_have_text("You handed control to ben.")
    expect(ann.get_by_test_id("driver")).to_contain_text("ben is driving")
    expect(ann.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")
    _assert_drives_only_after_a_word(ben, stack)


def test_the_driver_refuses_and_drives_on(ann: Page, ben: Page) -> None:
    """Who asked reads the no, and may ask again."""
    _ask(ben, ann)
    answer(ann, "refuse")
    expect(ben.get_by_test_id("control-note")).to_have_text("ann refused your request.")
    expect(ann.get_by_test_id("question")).to_be_hidden()
    expect_mode(ann, "drive")
    expect_mode(ben, "observe")
    _ask(ben, ann)
    ben.get_by_test_id("control-withdraw").click()
    expect(ann.get_by_test_id("question")).to_be_hidden()


@pytest.mark.release
def test_without_an_answer_the_control_passes_on(ann: Page, ben: Page, stack: Stack) -> None:
    """Both see 20 s count down; then the control is with who asked."""
    before = time.monotonic()
    _ask(ben, ann)
    asked = time.monotonic()
    for words in (ann.get_by_test_id("question-left"), ben.get_by_test_id("control-left")):
        expect(words).to_contain_text(re.compile(r" in 1\d s"), timeout=8_000)
    expect(ann.get_by_test_id("control")).to_have_attribute("data-mode", "observe", timeout=25_000)
    passed = time.monotonic()
    assert passed - before >= 20
    assert passed - asked < 24
    expect_mode(ben, "drive")
    expect_mode(ann, "observe")
    _assert_drives_only_after_a_word(ben, stack)


def test_a_driver_who_leaves_leaves_the_control_to_who_asked(ann: Page, ben: Page) -> None:
    """Who asked need not wait for the 20 s when the driver's page is gone."""
    _ask(ben, ann)
    ann.close()
    expect_mode(ben, "drive", seconds=8)
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "false")


def test_a_manager_takes_the_control_after_a_second_thought(
    page_users: PageUsers, ann: Page
) -> None:
    """Taking asks once more; no changes nothing, yes ends the driver's lease at once."""
    admin = page_users.open("admin", ROBOT)
    expect_mode(admin, "observe")
    admin.get_by_test_id("control-take").click()
    expect(admin.get_by_test_id("take-sure")).to_contain_text("Take control from ann?")
    answer(admin, "take-no")
    expect(admin.get_by_test_id("take-sure")).to_be_hidden()
    expect_mode(ann, "drive")
    admin.get_by_test_id("control-take").click()
    answer(admin, "take-yes")
    expect_mode(admin, "drive")
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("driver")).to_contain_text("admin is driving")
    expect(ann.get_by_test_id("control-note")).to_contain_text("You no longer drive")


def test_who_opens_a_robot_takes_nothing(page_users: PageUsers, stack: Stack) -> None:
    """Two who look: nobody drives, and no drive begins; the first to press Drive does."""
    before = _newest_fence(stack)
    pages = [page_users.open(name, ROBOT) for name in ("ann", "ben")]
    for page in pages:
        expect_mode(page, "observe")
        expect(page.get_by_test_id("driver")).to_have_text("Nobody is driving")
        expect(page.get_by_test_id("state")).to_contain_text("You are watching.")
        expect(page.get_by_test_id("control-drive")).to_be_visible()
    assert _newest_fence(stack) == before
    take_control(pages[0])
    expect(pages[0].get_by_test_id("driver")).to_contain_text("You are driving")
    expect(pages[1].get_by_test_id("driver")).to_contain_text("ann is driving (since")


def _newest_fence(stack: Stack) -> int:
    """The number of the robot's last lease, which each drive raises."""
    of_robot = f"robot_id = (SELECT id FROM robots WHERE name = '{ROBOT}')"
    [[fence]] = stack.sql(f"SELECT COALESCE(MAX(fence), 0) FROM drives WHERE {of_robot}")
    return int(fence)


class Key:
    """W."""

    def __init__(self, page: Page) -> None:
        self._keyboard = page.keyboard

    def press(self) -> None:
        self._keyboard.down("w")

    def release(self) -> None:
        self._keyboard.up("w")


class Stick:
    """The stick on the screen, by the mouse."""

    def __init__(self, page: Page) -> None:
        self._page = page

    def press(self) -> None:
        box = self._page.get_by_test_id("joystick").bounding_box()
        assert box is not None
        self._page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 4)
        self._page.mouse.down()

    def release(self) -> None:
        self._page.mouse.up()


class Pad:
    """A gamepad's stick, held forward, and its enable button."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._double = GamepadDouble(page)
        page.reload()
        self._double.plug_in()
        self._double.push(LEFT_Y, -1)

    def press(self) -> None:
        expect(self._page.get_by_test_id("gamepad")).to_have_attribute("data-state", "ready")
        self._double.press(LB)

    def release(self) -> None:
        self._double.release(LB)


@pytest.mark.parametrize("means", [Key, Stick, Pad])
def test_the_first_held_input_takes_the_control_and_drives(
    page_users: PageUsers, stack: Stack, means: type[Key | Stick | Pad]
) -> None:
    """In one press, as soon as the control is there, and the page says so."""
    page = page_users.open("ann", ROBOT)
    held = means(page)
    _wait_for_picture(page)
    page.evaluate(NOTE_TAKING)
    with SimWatch(stack, ROBOT) as watch:
        for _ in range(STRETCHES):
            expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "free")
            page_holds.note(page)
            page.evaluate("[window.pressedAt, window.takenMs] = [performance.now(), null]")
            pressed = time.monotonic()
            held.press()
            expect(page.get_by_test_id("control")).to_have_attribute("data-mode", "drive")
            wait_until(
                page,
                "the press that took the control drives, or was held up",
                lambda since=pressed: _drove(watch, since) or _was_held_up(page),
            )
            if _drove(watch, pressed):
                break
            held.release()
            page.get_by_test_id("control-leave").click()
        else:
            raise AssertionError("the machine never gave the control in time")
        held.release()
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
    expect(page.get_by_test_id("driver")).to_contain_text("You are driving")
    expect(page.get_by_test_id("control-note")).to_have_text("You took control.")


def _drove(watch: SimWatch, since: float) -> bool:
    """Whether the robot was told to move; the page may have had to let go since."""
    return any(seen.msg["linear"]["x"] != 0 for seen in watch.commands(since))


def _was_held_up(page: Page) -> bool:
    """Whether the control came late, or the machine or the picture made the page let go."""
    came_late: bool = page.evaluate("limit => window.takenMs > limit", TAKE_MS)
    return came_late or page_holds.had_to_let_go(page)


def test_a_key_that_is_let_go_before_the_control_comes_moves_nothing(
    page_users: PageUsers, stack: Stack
) -> None:
    """A tap takes the control; the robot stands."""
    page = page_users.open("ann", ROBOT)
    expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "free")
    page.route("**/api/v1/tickets", lambda route: _late(route, 0.4))
    with SimWatch(stack, ROBOT) as watch:
        page.keyboard.press("w", delay=50)
        expect_mode(page, "drive")
        expect_armed(page)
        page.wait_for_timeout(500)
        assert [seen for seen in watch.commands() if seen.msg["linear"]["x"] != 0] == []


def test_a_key_that_was_held_for_too_long_has_to_be_pressed_anew(
    page_users: PageUsers, stack: Stack
) -> None:
    """Control that comes late moves nothing that was pressed long ago."""
    page = page_users.open("ann", ROBOT)
    expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "free")
    page.route("**/api/v1/tickets", lambda route: _late(route, 1.5))
    with SimWatch(stack, ROBOT) as watch:
        page.keyboard.down("w")
        expect_mode(page, "drive")
        expect_armed(page)
        page.wait_for_timeout(500)
        assert [seen for seen in watch.commands() if seen.msg["linear"]["x"] != 0] == []
        page.keyboard.up("w")
        page_holds.drive(page, watch)
        page.keyboard.up("w")


def _late(route: Route, seconds: float) -> None:
    time.sleep(seconds)
    route.continue_()


def _wait_for_picture(page: Page) -> None:
    expect(page.get_by_test_id("tile").first).to_have_attribute("data-frame", "live")


def test_a_key_while_somebody_drives_takes_and_asks_nothing(
    ann: Page, ben: Page, stack: Stack
) -> None:
    """It says who drives and how to ask; the driver's page is not troubled, and the robot stands."""
    expect(ben.get_by_test_id("driver")).to_contain_text("ann is driving")
    with SimWatch(stack, ROBOT) as watch:
        ben.keyboard.press("w", delay=500)
        expect(ben.get_by_test_id("control-note")).to_have_text(
            "ann is driving. To drive, ask for control."
        )
        expect(ben.get_by_test_id("control-ask")).to_be_visible()
        assert watch.commands() == []
    expect_mode(ben, "observe")
    expect_mode(ann, "drive")
    expect(ann.get_by_test_id("question")).to_be_hidden()
    ann.get_by_test_id("control-leave").click()
    expect(ben.get_by_test_id("control-note")).to_have_text("")


def test_a_second_window_watches_until_its_person_goes_on_there(
    page_users: PageUsers, ann: Page, stack: Stack
) -> None:
    """Neither opening it nor a key takes the control from the first; its button does, and says so."""
    second = ann.context.new_page()
    page_users.go(second, ROBOT)
    expect_mode(second, "observe")
    expect(second.get_by_test_id("driver")).to_contain_text("You are driving in another window")
    second.keyboard.press("w", delay=500)
    expect(second.get_by_test_id("control-note")).to_contain_text("Press Drive here")
    expect_mode(second, "observe")
    expect_mode(ann, "drive")
    expect(second.get_by_test_id("control-drive")).to_have_text("Drive here")
    take_control(second)
    expect_mode(ann, "observe")
    expect(ann.get_by_test_id("control-note")).to_contain_text("another window")
    ann.bring_to_front()
    take_control(ann)
    expect_mode(second, "observe")


def test_a_reload_while_driving_drives_on_and_a_visit_does_not(
    page_users: PageUsers, ann: Page, ben: Page
) -> None:
    """The page that is loaded anew has the control again, armed; opened from the list it watches."""
    ann.reload()
    expect_mode(ann, "drive")
    expect_armed(ann)
    expect(ben.get_by_test_id("driver")).to_contain_text("ann is driving")
    page_users.go(ann, ROBOT)
    expect_mode(ann, "observe")
    expect(ben.get_by_test_id("driver")).to_have_text("Nobody is driving")
    ann.reload()
    expect_mode(ann, "observe")


def test_a_drive_enters_the_list_when_the_robot_moved(
    ann: Page, page_users: PageUsers, stack: Stack
) -> None:
    """Who took the control and gave it back is not in it; who moved the robot is."""
    ann.get_by_test_id("control-leave").click()
    expect_mode(ann, "observe")
    take_control(ann)
    expect_armed(ann)
    with SimWatch(stack, ROBOT) as watch:
        page_holds.drive(ann, watch)
        ann.keyboard.up("w")
    fence = _newest_fence(stack)
    ann.get_by_test_id("control-leave").click()
    headline = ann.get_by_test_id("summary-headline")
    expect(headline).to_have_text(re.compile("^Your drive: "), timeout=15_000)
    drives = f"{stack.url}/api/v1/drives?robot={ROBOT}"
    listed = [one["fence"] for one in ann.request.get(drives).json()["drives"]]
    assert fence in listed
    assert fence - 1 not in listed
    [still] = ann.request.get(f"{drives}&fence={fence - 1}").json()["drives"]
    assert (still["distance_m"], still["end_code"]) == (0, "control_given_up")


def test_control_that_was_given_up_is_free(ann: Page, ben: Page) -> None:
    """Who gives it up watches, and nobody gets it without a press."""
    ann.get_by_test_id("control-leave").click()
    expect_mode(ann, "observe")
    expect(ben.get_by_test_id("driver")).to_have_text("Nobody is driving")
    expect_mode(ben, "observe")
    ben.get_by_test_id("control-drive").click()
    expect_mode(ben, "drive")
    expect(ben.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")


@pytest.mark.usefixtures("usual_policy")
def test_a_new_policy_ends_a_motion_and_not_the_drive(ann: Page, stack: Stack) -> None:
    """The page comes back by itself, and what was held before moves nothing more until it is pressed anew."""
    with SimWatch(stack, ROBOT) as watch:
        page_holds.drive(ann, watch)
        # The page opens its connection anew.
        with ann.expect_websocket(lambda socket: "/ros?" in socket.url):
            stack.admin.set_robot(ROBOT, {"policy.limits.subscriptions": 99})
        expect_live(ann, seconds=10)
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
        ann.keyboard.up("w")
        page_holds.drive(ann, watch)
        ann.keyboard.up("w")

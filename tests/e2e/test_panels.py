"""The robot's own buttons, its topics, and what is told of a drive when it ends, on the drive page."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import page_holds
import pytest
from page_users import PageUsers, release_all
from pages import (
    drive_live,
    expect_armed,
    expect_mode,
    expect_no_sideways_scroll,
    open_drawer,
    open_live,
    wait_until,
)
from playwright.sync_api import Browser, Locator, Page, WebSocket, expect
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim2"
LIGHTS, SET_LIGHTS, DOCK, NOWHERE = range(4)
BUTTONS = [
    {"name": "Lights on", "kind": "publish", "topic": "/lights", "type": "std_msgs/Bool", "msg": {"data": True}},
    {"name": "Lights off", "kind": "call", "service": "/set_lights", "type": "std_srvs/SetBool",
     "args": {"data": False}},
    {"name": "Dock", "kind": "call", "service": "/dock", "type": "std_srvs/Trigger", "confirm": True},
    {"name": "Nowhere", "kind": "call", "service": "/nowhere"},
]  # fmt: skip
ALLOWED = {"publish": ["/lights"], "call": ["/set_lights", "/dock", "/nowhere"]}
PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
TABLET = {"viewport": {"width": 800, "height": 1280}, "has_touch": True}
# Of driving, in one of which the machine lets the page look all the time.
STRETCHES = 5
PLOTTED = re.compile(r"Now (1|0\.\d+); in the last minute 0 to (1|0\.\d+)\.")
HIDE = (
    "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
    "document.dispatchEvent(new Event('visibilitychange'))"
)
# Whether the connection has ended since.
NOTE_LEAVING = """() => {
  const state = document.querySelector("[data-testid=state]");
  new MutationObserver(() => (window.leftLive ||= state.dataset.state !== "live")).observe(state, {attributes: true});
}"""


def _set(stack: Stack, **settings: Any) -> None:
    changes = {path.replace("__", "."): value for path, value in settings.items()}
    stack.admin.set_robot(ROBOT, changes)
    stack.wait_for_changes(ROBOT)


@pytest.fixture(scope="module", autouse=True)
def _buttons(stack: Stack) -> Iterator[None]:
    """A robot with buttons that a driver may press."""
    try:
        _set(stack, policy__drive=ALLOWED, buttons=BUTTONS)
        yield
    finally:
        _set(stack, buttons=None, policy__drive=None)


@pytest.fixture(scope="module")
def token(stack: Stack) -> str:
    """An API token of the admin."""
    return stack.token("panel tests")


@pytest.fixture
def page_users(stack: Stack, browser: Browser) -> Iterator[PageUsers]:
    """Dora, who may drive, and Olga, who may watch; nobody drives yet, and afterwards the robot is not stopped."""
    stack.wait_until_drivable(ROBOT)
    try:
        with closing(PageUsers(stack, browser)) as people:
            people.let("dora", "drive", ROBOT)
            people.let("olga", "observe", ROBOT)
            yield people
    finally:
        release_all(stack, [ROBOT])
        stack.wait_until_free(ROBOT)


@pytest.fixture
def dora(page_users: PageUsers) -> Page:
    """Dora's page: she drives."""
    return page_users.drive("dora", ROBOT)


class Subscriptions:
    """What a page subscribes from now on: the topics of each WebSocket that it opens."""

    def __init__(self, page: Page) -> None:
        self.sockets: list[WebSocket] = []
        self.topics: list[str] = []
        page.on("websocket", self._opened)

    def _opened(self, socket: WebSocket) -> None:
        if "/ros?" not in socket.url:
            return
        self.sockets.append(socket)
        socket.on("framesent", self._sent)

    def _sent(self, payload: str | bytes) -> None:
        message = json.loads(payload)
        if message["op"] == "subscribe":
            self.topics.append(message["topic"])


def _button(page: Page, place: int) -> Locator:
    return page.get_by_test_id(f"button-{place}")


def _open_topics(page: Page, search: str = "") -> Locator:
    open_drawer(page)
    if not page.get_by_test_id("topic-search").is_visible():
        page.get_by_test_id("topics").locator("summary").first.click()
    page.get_by_test_id("topic-search").fill(search)
    return page.get_by_test_id("topic-list").get_by_role("button")


def _look(page: Page, name: str) -> Locator:
    _open_topics(page, name).get_by_text(name, exact=True).click()
    return page.locator(f"[data-testid=topic-look][data-topic='{name}']")


def test_a_button_publishes_and_another_calls(dora: Page) -> None:
    """The robot's lights go on and off, as its diagnostics tell, and its own words are shown."""
    content = _look(dora, "/diagnostics").get_by_test_id("topic-content")
    expect(content).to_contain_text("name: lights", timeout=10_000)
    outcome = dora.get_by_test_id("button-outcome")
    _button(dora, LIGHTS).click()
    expect(outcome).to_have_text("Lights on: sent to the robot.")
    expect(content).to_contain_text(re.compile(r"name: lights\s+message: on"), timeout=5_000)
    _button(dora, SET_LIGHTS).focus()
    dora.keyboard.press("Enter")
    expect(outcome).to_have_text("Lights off: done. The robot says: lights off", timeout=5_000)
    expect(content).to_contain_text(re.compile(r"name: lights\s+message: off"), timeout=5_000)


def test_a_button_that_asks_waits_for_yes_and_moves_nothing(dora: Page) -> None:
    """The question takes the button's place, is answered with the keyboard, and the stick stays where it is."""
    stick = dora.get_by_test_id("joystick")
    _button(dora, DOCK).scroll_into_view_if_needed()
    before = stick.bounding_box()
    _button(dora, DOCK).click()
    expect(dora.get_by_test_id(f"button-{DOCK}-no")).to_be_focused()
    assert stick.bounding_box() == before
    dora.keyboard.press("Enter")
    expect(_button(dora, DOCK)).to_be_focused()
    expect(dora.get_by_test_id("button-outcome")).to_have_text("")
    dora.keyboard.press("Enter")
    yes = dora.get_by_test_id(f"button-{DOCK}-yes")
    expect(yes).to_be_enabled()  # a double press is no answer
    dora.keyboard.press("Shift+Tab")
    expect(yes).to_be_focused()
    dora.keyboard.press("Enter")
    expect(dora.get_by_test_id("button-outcome")).to_have_text(
        "Dock: done. The robot says: docked, the battery charges", timeout=5_000
    )
    assert stick.bounding_box() == before


@pytest.mark.parametrize("context", [TABLET], indirect=True, ids=["tablet"])
def test_a_second_finger_presses_a_button(page: Page, stack: Stack) -> None:
    """The first one drives on meanwhile."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    _button(page, SET_LIGHTS).scroll_into_view_if_needed()
    devtools = page.context.new_cdp_session(page)

    # Of a touchEnd, the points are those that lift.
    def touch(kind: str, points: dict[int, tuple[float, float]]) -> None:
        touches = [{"x": x, "y": y, "id": finger} for finger, (x, y) in points.items()]
        devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    (x, y), button = _centre(page, "joystick"), _centre(page, f"button-{SET_LIGHTS}")
    outcome = page.get_by_test_id("button-outcome")
    with SimWatch(stack, ROBOT) as watch:
        for _ in range(STRETCHES):
            outcome.evaluate("element => (element.textContent = '')")
            expect_armed(page)
            page_holds.note(page)
            touch("touchStart", {0: (x, y)})
            touch("touchMove", {0: (x, y - 40)})
            watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0.1)
            touch("touchStart", {0: (x, y - 40), 1: button})
            touch("touchEnd", {1: button})
            expect(outcome).to_contain_text("lights off", timeout=5_000)
            drives_on = watch.pose["linear_velocity"] > 0.1
            had_to_let_go = page_holds.had_to_let_go(page)
            touch("touchEnd", {0: (x, y - 40)})
            watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
            if drives_on or not had_to_let_go:
                break
        assert drives_on


def test_a_service_that_is_not_there_is_said(dora: Page) -> None:
    """In the robot's own words."""
    _button(dora, NOWHERE).click()
    expect(dora.get_by_test_id("button-outcome")).to_have_text(
        re.compile(r"Nowhere: failed\. .*nowhere"), timeout=5_000
    )
    expect(_button(dora, NOWHERE)).to_contain_text("Failed")


def test_the_space_bar_on_a_button_stops_and_presses_nothing(dora: Page) -> None:
    """As everywhere on the page; afterwards the buttons say that they wait for a driver."""
    _button(dora, LIGHTS).focus()
    dora.keyboard.press("Space")
    expect(dora.get_by_test_id("stop-bar")).to_have_attribute("data-stop", "stopped")
    expect(dora.get_by_test_id("button-outcome")).to_have_text("")
    expect(_button(dora, LIGHTS)).to_have_attribute("aria-disabled", "true")
    expect(dora.get_by_test_id("buttons")).to_contain_text("These work while you drive.")


def test_who_watches_presses_no_button(page_users: PageUsers, dora: Page, stack: Stack) -> None:
    """A second driver's buttons do nothing until she drives; an observer has none."""
    page_users.let("eva", "drive", ROBOT)
    eva = page_users.open("eva", ROBOT)
    expect_mode(eva, "observe")
    expect(_button(eva, SET_LIGHTS)).to_have_attribute("aria-disabled", "true")
    _button(eva, SET_LIGHTS).dispatch_event("click")
    olga = page_users.open("olga", ROBOT)
    expect(olga.get_by_test_id("buttons")).to_have_count(0)
    expect(eva.get_by_test_id("button-outcome")).to_have_text("")
    dora.get_by_test_id("control-leave").click()
    eva.get_by_test_id("control-drive").click()
    expect(_button(eva, SET_LIGHTS)).to_have_attribute("aria-disabled", "false", timeout=10_000)


def test_what_the_policy_refuses_is_said(dora: Page, stack: Stack) -> None:
    """An open page still shows buttons that an admin has taken away; the server lets none of them through."""
    dora.evaluate(NOTE_LEAVING)
    _set(stack, buttons=None, policy__drive=None)
    try:
        # The connection ended with the policy, and the page drives again.
        dora.wait_for_function("() => window.leftLive")
        expect_mode(dora, "drive", seconds=10)
        outcome = dora.get_by_test_id("button-outcome")
        _button(dora, SET_LIGHTS).click()
        expect(outcome).to_contain_text(
            "cannot call /set_lights: the robot's policy does not let you"
        )
        _button(dora, LIGHTS).click()
        expect(outcome).to_contain_text(
            "cannot publish to /lights: the robot's policy does not let you"
        )
    finally:
        _set(stack, policy__drive=ALLOWED, buttons=BUTTONS)


def test_no_topic_is_asked_for_until_it_is_opened(page_users: PageUsers, stack: Stack) -> None:
    """Neither by the closed list nor by the open one; a hidden page ends what was opened."""
    page = page_users.open_fleet("dora")
    subscribed = Subscriptions(page)
    open_live(page, stack, ROBOT)
    expect(_open_topics(page, "no such topic")).to_have_count(0)
    expect(_open_topics(page).filter(has_text="/battery_state")).to_have_count(1)
    sockets, asked = len(subscribed.sockets), subscribed.topics.count("/battery_state")
    _look(page, "/battery_state")
    expect(page.get_by_test_id("topic-content")).to_contain_text("percentage", timeout=10_000)
    # On a connection of its own, which a message that is too large may end.
    assert len(subscribed.sockets) == sockets + 1
    assert subscribed.topics.count("/battery_state") == asked + 1
    page.evaluate(HIDE)
    expect(page.get_by_test_id("topic-notice")).to_have_text(
        "Not connected. This page reconnects by itself."
    )
    wait_until(page, "closed", subscribed.sockets[-1].is_closed)


def test_a_message_is_looked_into_and_a_number_plotted(dora: Page, stack: Stack) -> None:
    """The speed that is driven is the one that is plotted; the rate is measured on request."""
    look = _look(dora, "/odom")
    expect(look.get_by_test_id("topic-content")).to_contain_text("covariance", timeout=10_000)
    look.get_by_test_id("topic-field").select_option("twist.twist.linear.x")
    words = look.get_by_test_id("topic-plot-words")
    expect(words).to_contain_text("Now 0;")

    def is_plotted() -> bool:
        return bool(PLOTTED.fullmatch(words.text_content() or ""))

    with SimWatch(stack, ROBOT) as watch:
        for _ in range(STRETCHES):
            expect_armed(dora)
            page_holds.note(dora)
            dora.keyboard.down("w")
            watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0.1)
            wait_until(
                dora,
                "plotted",
                lambda: is_plotted() or watch.pose["linear_velocity"] == 0,
                seconds=5,
            )
            plotted, had_to_let_go = is_plotted(), page_holds.had_to_let_go(dora)
            dora.keyboard.up("w")
            if plotted or not had_to_let_go:
                break
        assert plotted, words.text_content()
    drawn = look.get_by_test_id("topic-plot").evaluate(
        "canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(Boolean)"
    )
    assert drawn
    expect(look.get_by_test_id("topic-rate")).to_contain_text("At least ")
    look.get_by_test_id("topic-measure").click()
    expect(look.get_by_test_id("topic-rate")).to_contain_text(
        re.compile(r"^\d\d(\.\d)? messages/s, measured"), timeout=10_000
    )


def test_two_topics_are_open_at_a_time(dora: Page) -> None:
    """The third takes the place of the first; closing one gives the focus back to the list."""
    for name in ("/scan", "/battery_state", "/odom"):
        _look(dora, name)
    looks = dora.get_by_test_id("topic-look")
    expect(looks).to_have_count(2)
    assert [look.get_attribute("data-topic") for look in looks.all()] == ["/battery_state", "/odom"]
    looks.last.get_by_test_id("topic-close").click()
    expect(looks).to_have_count(1)
    expect(dora.get_by_test_id("topic-list").get_by_role("button").first).to_be_focused()


def test_a_picture_comes_only_when_it_is_asked_for(dora: Page) -> None:
    """One message at a time, after the page has said what that costs."""
    subscribed = Subscriptions(dora)
    look = _look(dora, "/camera/image_raw/compressed")
    expect(look).to_contain_text("can be several MB large.")
    expect(look.get_by_test_id("topic-content")).to_have_text("")
    assert subscribed.topics == []
    look.get_by_test_id("topic-get-one").click()
    expect(look.get_by_test_id("topic-content")).to_contain_text("more characters", timeout=10_000)
    expect(look.get_by_test_id("topic-rate")).to_contain_text(re.compile(r"\d+ KB each"))
    assert subscribed.topics == ["/camera/image_raw/compressed"]


def test_an_observer_looks_at_topics(page_users: PageUsers) -> None:
    """What the policy lets observers subscribe to."""
    olga = page_users.open("olga", ROBOT)
    look = _look(olga, "/odom")
    expect(look.get_by_test_id("topic-content")).to_contain_text("covariance", timeout=10_000)


def test_a_drive_that_ends_is_told_and_saved(
    dora: Page, stack: Stack, token: str, tmp_path: Path
) -> None:
    """In words on the page, and as the record that the server keeps."""
    with SimWatch(stack, ROBOT) as watch:
        expect_armed(dora)
        dora.keyboard.down("w")
        watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0.1)
        dora.wait_for_timeout(1000)
        dora.keyboard.up("w")
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
    dora.get_by_test_id("control-leave").click()
    headline = dora.get_by_test_id("summary-headline")
    expect(headline).to_have_text(re.compile(r"^Your drive: \d+ s, \d+\.\d m$"), timeout=15_000)
    expect(dora.get_by_test_id("summary-ended")).to_have_text("you gave up control")
    expect(dora.get_by_test_id("summary-latency")).to_have_text(
        re.compile(r"^\d+ ms; 95 % within \d+ ms$")
    )
    expect(dora.get_by_test_id("summary-pictures")).to_have_text(
        re.compile(r"^\d.* a second, \d.* [KM]B$")
    )
    expect(dora.get_by_test_id("summary-stops")).to_have_text("None")
    assert _is_on_top(dora, "stop")
    headline.click()
    with dora.expect_download() as download:
        dora.get_by_test_id("summary-save").click()
    file = tmp_path / "drive.json"
    download.value.save_as(file)
    saved = json.loads(file.read_text())
    bearer = {"Authorization": f"Bearer {token}"}
    status, kept = stack.request("GET", f"/api/v1/drives/{saved['id']}", headers=bearer)
    assert status == 200
    assert {name: kept[name] for name in ("robot", "user", "fence", "distance_m")} == {
        "robot": ROBOT, "user": "dora", "fence": saved["fence"], "distance_m": saved["distance_m"],
    }  # fmt: skip
    assert saved["distance_m"] > 0.1
    dora.get_by_test_id("control-drive").click()
    expect_mode(dora, "drive")
    expect(dora.get_by_test_id("summary-rows")).to_be_hidden()


def test_a_stopped_drive_tells_of_the_stop(dora: Page, stack: Stack) -> None:
    """The summary of a drive that moved the robot comes by itself, folded: the picture counts now."""
    with SimWatch(stack, ROBOT) as watch:
        expect_armed(dora)
        dora.keyboard.down("w")
        watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0.1)
        dora.keyboard.up("w")
    dora.keyboard.press("Space")
    expect(dora.get_by_test_id("summary-ended")).to_have_text("robot stopped", timeout=15_000)
    expect(dora.get_by_test_id("summary-stops")).to_have_text("1")
    expect(dora.get_by_test_id("summary-headline")).to_be_visible()
    expect(dora.get_by_test_id("summary-rows")).to_be_hidden()


@pytest.mark.parametrize("context", [PHONE], indirect=True, ids=["phone"])
def test_panels_fit_a_phone(page: Page, stack: Stack) -> None:
    """Nothing is wider than the screen, and Stop stays on it, with nothing over it."""
    drive_live(page, stack, ROBOT)
    look = _look(page, "/odom")
    expect(look.get_by_test_id("topic-content")).to_contain_text("covariance", timeout=10_000)
    look.get_by_test_id("topic-field").select_option("twist.twist.linear.x")
    look.get_by_test_id("topic-plot").scroll_into_view_if_needed()
    expect_no_sideways_scroll(page)
    expect(page.get_by_test_id("stop")).to_be_in_viewport()


def _centre(page: Page, test_id: str) -> tuple[float, float]:
    box = page.get_by_test_id(test_id).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def _is_on_top(page: Page, test_id: str) -> bool:
    found = page.evaluate(
        "([x, y]) => document.elementFromPoint(x, y)?.closest('[data-testid]')?.dataset.testid",
        list(_centre(page, test_id)),
    )
    return bool(found == test_id)

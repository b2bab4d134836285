"""The robot's own buttons, and what is told of a drive when it ends, on the drive page.

What a button or a summary says in which case are unit tests of robotButtons.js and driveSummary.js.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import page_holds
import pytest
from page_users import PageUsers, release_all
from pages import (
    open_drawer,
)
from playwright.sync_api import Browser, Locator, Page, expect
from sim_service import call_sim
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim2"
LIGHTS, SET_LIGHTS, DOCK = range(3)
BUTTONS = [
    {"name": "Lights on", "kind": "publish", "topic": "/lights", "type": "std_msgs/Bool", "msg": {"data": True}},
    {"name": "Lights off", "kind": "call", "service": "/set_lights", "type": "std_srvs/SetBool",
     "args": {"data": False}},
    {"name": "Dock", "kind": "call", "service": "/dock", "type": "std_srvs/Trigger", "confirm": True},
]  # fmt: skip
ALLOWED = {"publish": ["/lights"], "call": ["/set_lights", "/dock"]}


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
    return stack.token("panel tests")


@pytest.fixture
def page_users(stack: Stack, browser: Browser) -> Iterator[PageUsers]:
    """Dora, who may drive, and Olga, who may watch; nobody drives yet, and afterwards the robot is not stopped."""
    stack.wait_until_drivable(ROBOT)
    # Not at a wall, to which another test may have driven it.
    call_sim(stack, ROBOT, "/reset")
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
    return page_users.drive("dora", ROBOT)


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


def test_buttons_publish_call_ask_and_work_for_drivers_alone(
    page_users: PageUsers, dora: Page
) -> None:
    """The lights follow, as the diagnostics tell; a question takes a button's place; Space on a button is Stop."""
    content = _look(dora, "/diagnostics").get_by_test_id("topic-content")
    expect(content).to_contain_text("name: lights")
    outcome, stick = dora.get_by_test_id("button-outcome"), dora.get_by_test_id("joystick")
    _button(dora, LIGHTS).click()
    expect(outcome).to_have_text("Lights on: sent to the robot.")
    expect(content).to_contain_text(re.compile(r"name: lights\s+message: on"))
    _button(dora, SET_LIGHTS).focus()
    dora.keyboard.press("Enter")
    expect(outcome).to_have_text("Lights off: done. The robot says: lights off")
    expect(content).to_contain_text(re.compile(r"name: lights\s+message: off"))
    olga = page_users.open("olga", ROBOT)
    expect(olga.get_by_test_id("buttons")).to_have_count(0)
    dora.bring_to_front()
    _button(dora, DOCK).scroll_into_view_if_needed()
    before = stick.bounding_box()
    _button(dora, DOCK).click()
    expect(dora.get_by_test_id(f"button-{DOCK}-no")).to_be_focused()
    yes = dora.get_by_test_id(f"button-{DOCK}-yes")
    expect(yes).to_be_enabled()  # a double press is no answer
    dora.keyboard.press("Shift+Tab")
    expect(yes).to_be_focused()
    dora.keyboard.press("Enter")
    expect(outcome).to_have_text("Dock: done. The robot says: docked, the battery charges")
    assert stick.bounding_box() == before
    _button(dora, LIGHTS).focus()
    dora.keyboard.press("Space")
    expect(dora.get_by_test_id("stop-bar")).to_have_attribute("data-stop", "stopped")
    expect(outcome).not_to_contain_text("Lights")
    expect(_button(dora, LIGHTS)).to_have_attribute("aria-disabled", "true")
    expect(dora.get_by_test_id("buttons")).to_contain_text("These work while you drive.")


def test_a_drive_that_ends_is_told_and_saved(
    dora: Page, stack: Stack, token: str, tmp_path: Path
) -> None:
    """By a stop: in words on the page, folded, as the picture counts now; and as the record that the server keeps."""
    with SimWatch(stack, ROBOT) as watch:
        start = watch.pose["x"], watch.pose["y"]
        page_holds.drive(dora, watch)
        watch.wait_pose("driven", lambda pose: math.dist(start, (pose["x"], pose["y"])) > 0.2)
        dora.keyboard.up("w")
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
    dora.keyboard.press("Space")
    headline = dora.get_by_test_id("summary-headline")
    expect(headline).to_have_text(re.compile(r"^Your drive: \d+ s, \d+\.\d m$"), timeout=15_000)
    expect(dora.get_by_test_id("summary-ended")).to_have_text("robot stopped")
    expect(dora.get_by_test_id("summary-latency")).to_have_text(
        re.compile(r"^\d+ ms; 95 % within \d+ ms$")
    )
    expect(dora.get_by_test_id("summary-pictures")).to_have_text(
        re.compile(r"^\d.* a second, \d.* [KM]B$")
    )
    expect(dora.get_by_test_id("summary-stops")).to_have_text("1")
    expect(dora.get_by_test_id("summary-rows")).to_be_hidden()
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

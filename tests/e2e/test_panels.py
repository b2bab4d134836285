"""The robot's own buttons on the drive page.

What a button says in which case are unit tests of robotButtons.js.
"""

import re
from contextlib import closing

import pytest
from page_users import PageUsers, release_all
from pages import open_drawer
from playwright.sync_api import expect

ROBOT = "sim2"
LIGHTS, SET_LIGHTS, DOCK = range(3)
BUTTONS = [
    {"name": "Lights on", "kind": "publish", "topic": "/lights", "type": "std_msgs/Bool", "msg": {"data": True}},
    {"name": "Lights off", "kind": "call", "service": "/set_lights", "type": "std_srvs/SetBool",
     "args": {"data": False}},
    {"name": "Dock", "kind": "call", "service": "/dock", "type": "std_srvs/Trigger", "confirm": True},
]  # fmt: skip
ALLOWED = {"publish": ["/lights"], "call": ["/set_lights", "/dock"]}


@pytest.fixture
def page_users(stack, browser):
    """Dora, who may drive a robot with buttons; nobody drives yet."""
    stack.wait_until_drivable(ROBOT)
    stack.admin.set_robot(ROBOT, {"policy.drive": ALLOWED, "buttons": BUTTONS})
    stack.wait_for_changes(ROBOT)
    try:
        with closing(PageUsers(stack, browser)) as people:
            people.let("dora", "drive", ROBOT)
            yield people
    finally:
        release_all(stack, [ROBOT])
        stack.admin.set_robot(ROBOT, {"policy.drive": None, "buttons": None})
        stack.wait_for_changes(ROBOT)


def _button(page, place):
    return page.get_by_test_id(f"button-{place}")


def test_buttons_publish_call_ask_and_work_for_drivers_alone(page_users):
    """The lights follow, as the diagnostics tell; a question takes a button's place; Space on a button is Stop."""
    dora = page_users.drive("dora", ROBOT)
    open_drawer(dora)
    dora.get_by_test_id("topics").locator("summary").first.click()
    dora.get_by_test_id("topic-list").get_by_text("/diagnostics", exact=True).click()
    content = dora.get_by_test_id("topic-content")
    expect(content).to_contain_text("name: lights")
    outcome, stick = dora.get_by_test_id("button-outcome"), dora.get_by_test_id("joystick")
    _button(dora, LIGHTS).click()
    expect(outcome).to_have_text("Lights on: sent to the robot.")
    expect(content).to_contain_text(re.compile(r"name: lights\s+message: on"))
    _button(dora, SET_LIGHTS).focus()
    dora.keyboard.press("Enter")
    expect(outcome).to_have_text("Lights off: done. The robot says: lights off")
    expect(content).to_contain_text(re.compile(r"name: lights\s+message: off"))
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

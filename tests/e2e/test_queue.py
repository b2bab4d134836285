"""A robot asks for help: three people in their browsers, of whom one passes it on, one drives, and one supervises."""

import re
from contextlib import closing

import page_holds
import pytest
from page_users import PageUsers
from pages import expect_armed, expect_mode
from playwright.sync_api import expect
from sim_watch import SimWatch

ROBOT = "sim1"
REASON = "stuck at <b>gate</b> 3"
NOTE = "pushed it <i>back</i>"


@pytest.fixture
def page_users(stack, browser):
    """Quinn and Rosa, who may drive, and Sven, who manages; nobody has asked for anything."""
    stack.wait_until_drivable(ROBOT)
    with closing(PageUsers(stack, browser)) as people:
        for name in ("quinn", "rosa"):
            people.let(name, "drive", ROBOT)
        people.let("sven", "manage", ROBOT)
        yield people
    for request in stack.admin.ask("GET", "/requests")["requests"]:
        stack.admin.ask("POST", f"/requests/{request['id']}/cancel", {})


def _be_available(people, name):
    page = people.browse(name)
    page.goto(f"{people.stack.url}/queue")
    page.get_by_test_id("be-available").click()
    expect(page.get_by_test_id("queue-state")).to_contain_text("You are available.")
    return page


def _supervise(people):
    page = people.browse("sven")
    page.goto(f"{people.stack.url}/queue/supervise")
    return page


def _ask(stack):
    stack.admin.ask("POST", f"/robots/{ROBOT}/requests", {"reason": REASON, "priority": 1})


def _expect_offer(page):
    expect(page.get_by_test_id("offer-robot")).to_have_text(ROBOT)
    expect(page.get_by_test_id("offer-reason")).to_have_text(REASON)
    expect(page.get_by_test_id("offer-left")).to_have_text(re.compile(r"^\d+ s left$"))


def _press(page, test_id):
    """Press what takes no press in its first moment."""
    page.locator(f"[data-testid={test_id}]:not([aria-disabled])").click()


def _drive_and_close(page, stack):
    page.wait_for_url(f"**/robots/{ROBOT}")
    expect_mode(page, "drive")
    expect_armed(page)
    expect(page.get_by_test_id("help-badge")).to_be_visible()
    with SimWatch(stack, ROBOT) as watch:
        page_holds.drive(page, watch)
        page.keyboard.up("w")
        watch.wait_standing()
    page.goto(f"{stack.url}/queue")
    expect(page.get_by_test_id("queue-state")).to_have_text(f"You are busy with {ROBOT}.")
    page.get_by_test_id("close-note").fill(NOTE)
    _press(page, "close-request")
    expect(page.get_by_test_id("close-outcome")).to_have_text(f"The request of {ROBOT} is closed.")
    expect(page.get_by_test_id("queue-state")).to_contain_text("Wrap-up")


def test_a_request_passes_from_one_operator_to_the_next_who_drives(page_users, stack):
    quinn, rosa = (_be_available(page_users, name) for name in ("quinn", "rosa"))
    expect(quinn.get_by_test_id("queue-state")).to_have_text("You are available. You are next.")
    expect(rosa.get_by_test_id("queue-state")).to_contain_text("1 operator is before you.")
    sven = _supervise(page_users)
    state = sven.get_by_test_id("open-request").locator("[data-part=state]")
    _ask(stack)
    _expect_offer(quinn)
    expect(quinn).to_have_title(f"Offer: {ROBOT}")
    expect(state).to_have_text("Offered to quinn")
    _press(quinn, "offer-decline")
    expect(quinn.get_by_test_id("offer-outcome")).to_have_text(f"You declined {ROBOT}.")
    _expect_offer(rosa)
    _press(rosa, "offer-accept")
    expect(state).to_have_text("rosa works on it")
    expect(sven.locator("[data-testid=operators] tr", has_text="rosa")).to_contain_text("Busy")
    expect(quinn.get_by_test_id("queue-state")).to_contain_text("You are available.")
    _drive_and_close(rosa, stack)
    expect(sven.get_by_test_id("open-none")).to_have_text("No request is open.")
    [closed, *_] = stack.admin.ask("GET", f"/requests?state=closed&robot={ROBOT}")["requests"]
    assert (closed["accepted_by"], closed["reason"], closed["note"]) == ("rosa", REASON, NOTE)

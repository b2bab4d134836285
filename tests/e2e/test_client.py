"""Pages of others: robotether-client on a page of another site, as docs/reference/client.md tells, in a real browser.

The lab's site is a double: the browser is given its pages by the test, under the name that ALLOWED_ORIGINS has. Its
backend, which keeps the token, is the test itself.
"""

import re
import time
from contextlib import contextmanager

import pytest
from page_users import release_all
from playwright.sync_api import expect
from sim_watch import SimWatch
from stack import LAB, ROOT

ROBOT = "sim1"
EXAMPLE = (ROOT / "docs" / "tutorial" / "robotether_client.html").read_text()
FIRST_LINES = re.search(
    r"```js\n(.*?)```", (ROOT / "docs" / "reference" / "client.md").read_text(), re.DOTALL
)
EMPTY = '<!doctype html><meta charset="utf-8"><title>Lab</title><img id="picture"><p>Lab'

# How many colours the page's canvas has: 1 when nothing was drawn.
COUNT_COLOURS = """() => {
  const c = document.querySelector("canvas");
  const d = new Uint32Array(c.getContext("2d").getImageData(0, 0, c.width, c.height).data.buffer);
  return new Set(d).size;
}"""


@pytest.fixture(scope="module")
def token(stack):
    return stack.token("client")


@pytest.fixture(autouse=True)
def _drivable(stack):
    stack.wait_until_drivable(ROBOT)


@contextmanager
def _at(browser, origin, html):
    """A page of another site, not yet opened."""
    # The stack is on this machine: there Chromium asks its user before a page of another site may reach it.
    context = browser.new_context(ignore_https_errors=True, permissions=["local-network-access"])
    errors = []
    try:
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.route(f"{origin}/**", lambda route: route.fulfill(body=html, content_type="text/html"))
        yield page
    finally:
        context.close()
    assert errors == [], f"the page raised {errors}"


@pytest.fixture
def lab(stack, browser, token):
    """An empty page of the lab, whose backend gives tickets."""
    headers = {"Authorization": f"Bearer {token}"}

    def ticket(wish):
        status, answer = stack.request("POST", "/api/v1/tickets", wish, headers)
        assert status == 201, answer
        return str(answer["ticket"])

    with _at(browser, LAB, EMPTY) as page:
        page.expose_function("backendTicket", ticket)
        page.goto(f"{LAB}/")
        yield page


def _expect_value(page, expression, condition):
    end = time.monotonic() + 10
    while not condition(value := page.evaluate(expression)):
        assert time.monotonic() < end, f"{expression} is {value}"
        time.sleep(0.05)


def test_the_documented_page_drives_from_another_site(stack, browser, token):
    """It shows video and speed, drives while its button is held, stands when it is let go, and stops the robot."""
    try:
        with _at(browser, LAB, EXAMPLE) as page, SimWatch(stack, ROBOT) as watch:
            page.goto(f"{LAB}/#{stack.url} {ROBOT} {token}")
            _drive_and_stop(page, watch, stack, token)
    finally:
        release_all(stack, [ROBOT])


def _drive_and_stop(page, watch, stack, token):
    expect(page.locator("#state")).to_have_text("driving", timeout=15_000)
    _expect_value(page, "document.querySelector('output').value", lambda value: value == "0.00")
    page.locator("#forward").hover()
    page.mouse.down()
    watch.wait_moving()
    _expect_value(page, "document.querySelector('output').value", lambda value: value == "0.30")
    page.mouse.up()
    watch.wait_standing()
    _expect_value(page, COUNT_COLOURS, lambda colours: colours > 10)
    page.locator("#stop").click()
    stack.wait("stopped", lambda: _stopped(stack, token), "relay")
    expect(page.locator("#state")).to_have_text("live", timeout=10_000)


def _stopped(stack, token):
    headers = {"Authorization": f"Bearer {token}"}
    _, control = stack.request("GET", f"/api/v1/robots/{ROBOT}/control", None, headers)
    return bool(control["stopped"])


def test_the_documented_lines_drive_and_show_video(lab, stack):
    """The lines work unchanged on a page with a stick, a canvas and a backend that gives tickets."""
    lab.evaluate(
        "document.body.append(document.createElement('canvas'));"
        "Object.assign(window, { getTicket: backendTicket, stick: { x: 0, y: 0 } })"
    )
    with SimWatch(stack, ROBOT) as watch:
        with lab.expect_console_message(lambda speed: speed.text == "0", timeout=15_000):
            lines = FIRST_LINES[1].replace("https://robots.example", stack.url)
            lab.add_script_tag(type="module", content=lines)
        lab.evaluate("void (stick.y = 0.3)")
        watch.wait_moving()
        _expect_value(lab, COUNT_COLOURS, lambda colours: colours > 10)
        lab.evaluate("void (stick.y = 0)")
        watch.wait_standing()


def test_a_site_that_is_not_allowed_gets_nothing(stack, browser, token):
    other = "https://other.example"
    with _at(browser, other, EMPTY) as page:
        page.goto(f"{other}/")
        connected, *states = page.evaluate(
            """async ([server, robot, token]) => {
              const { Robot } = await import(`${server}/static/dist/robotether-client.js`);
              const mine = new Robot({ server, robot, token });
              const states = [];
              mine.on("state", ({ name, reason }) => states.push([name, reason]));
              const connected = mine.connect().then(() => "connected", ({ message }) => message);
              while (!states.at(-1)?.[1]) await new Promise((resolve) => setTimeout(resolve, 50));
              mine.close();
              return [await connected, ...states];
            }""",
            [stack.url, ROBOT, token],
        )
    names = [name for name, _ in states]
    assert (names[:2], names[-1]) == (["connecting", "server_unreachable"], "closed")
    assert f"{other} in its ALLOWED_ORIGINS" in states[-2][1]
    assert connected == f"cannot connect to {ROBOT}: closed"

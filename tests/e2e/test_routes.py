"""Routes on the whole stack, drawn on the page: sim2 follows sim1, or an app, until something ends that."""

import re
import time
from contextlib import closing

import page_holds
import pytest
from page_users import PageUsers, release_all
from pages import expect_armed
from playwright.sync_api import expect
from sim_watch import SimWatch

ROBOTS = ["sim1", "sim2"]
# A web app in a page with its user's login: it stands still until it is to turn on the spot, and keeps what it gets.
APP = """async () => {
  const { App } = await import("/static/dist/robotether-client.js");
  const twist = "geometry_msgs/msg/Twist";
  const app = new App({ name: "stick" });
  app.advertise("/stick", twist);
  app.subscribe("/pose", "nav_msgs/msg/Odometry", (message) => (window.odometry = message));
  await app.connect();
  const message = { linear: { x: 0, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } };
  window.turn = (z) => (message.angular.z = z);
  setInterval(() => app.publish("/stick", twist, message), 50);
}"""


@pytest.fixture(scope="module")
def page_users(stack, browser):
    """Mia, who manages sim1 and sim2."""
    with closing(PageUsers(stack, browser)) as people:
        for robot in ROBOTS:
            stack.wait_until_drivable(robot)
            people.let("mia", "manage", robot)
        yield people


@pytest.fixture(autouse=True)
def _no_routes(stack):
    """Both robots are free, before and afterwards."""
    for robot in ROBOTS:
        stack.wait_until_drivable(robot)
    yield
    for route in stack.admin.ask("GET", "/routes")["routes"]:
        stack.admin.ask("DELETE", f"/routes/{route['id']}")
    release_all(stack, ROBOTS)


@pytest.fixture(scope="module")
def page(page_users):
    """Mia's page of routes, with the topics of both robots."""
    page = page_users.browse("mia")
    page.goto(f"{page_users.stack.url}/routes")
    for side in ("source", "target"):
        for robot in ROBOTS:
            expect(_topic(page, side, robot)).to_be_visible(timeout=30_000)
    return page


def _topic(page, side, robot, name="/cmd_vel"):
    return page.locator(f'[data-side="{side}"] [data-of="{robot}"][data-topic="{name}"]')


def _drag(page, start, end):
    start.scroll_into_view_if_needed()
    start.hover()
    page.mouse.down()
    end.scroll_into_view_if_needed()
    end.hover()
    page.mouse.up()


def _state(page):
    return page.get_by_test_id("routes").locator('[data-part="state"]').first


def _driver(stack):
    return stack.admin.ask("GET", "/robots/sim2/control")["driver"]


def test_sim2_follows_sim1_until_somebody_stops_it(page, page_users, stack):
    """A line that is dragged from topic to topic drives sim2, under the lease of its maker's route."""
    _drag(page, _topic(page, "source", "sim1"), _topic(page, "target", "sim2"))
    expect(_state(page)).to_have_text(re.compile(r"Runs, "))
    assert _driver(stack)["user"] == "mia (route)"
    driving = page_users.drive("mia", "sim1")
    expect_armed(driving)
    with SimWatch(stack, "sim1") as leader, SimWatch(stack, "sim2") as follower:
        page_holds.drive(driving, leader)
        follower.wait_moving()
        expect(_state(page)).to_have_text(re.compile(r"Runs, [1-9][0-9.]*/s"))
        stack.admin.ask("POST", "/robots/sim2/stop", {"reason": "routes"})
        follower.wait_standing()
        assert leader.pose["linear_velocity"] > 0 or page_holds.had_to_let_go(driving)
        driving.close()
    expect(_state(page)).to_have_text("Ended: the target was stopped")
    release_all(stack, ["sim2"])
    stack.wait_for_changes("sim2")
    assert _driver(stack) is None
    assert [route["end_code"] for route in stack.admin.ask("GET", "/routes")["routes"]] == [
        "robot_stopped"
    ]


def test_a_route_by_keyboard_ends_with_the_right_of_its_maker(page, stack):
    """Within 2 s, though the right comes back at once."""
    _topic(page, "source", "sim1").focus()
    page.keyboard.press("Enter")
    _topic(page, "target", "sim2").focus()
    page.keyboard.press("Enter")
    expect(_state(page)).to_have_text(re.compile(r"Runs, "))
    assert _driver(stack)["user"] == "mia (route)"
    stack.admin.ask("DELETE", "/grants/mia/sim1")
    begun_s = time.monotonic()
    while _driver(stack) is not None:
        assert time.monotonic() - begun_s < 2
        time.sleep(0.05)
    stack.admin.grant("mia", "sim1", "manage")
    stack.wait_for_right("mia", "sim1")
    expect(_state(page)).to_have_text("Ended: its maker may no longer manage its robots")
    assert _driver(stack) is None


def test_an_app_drives_sim2_and_gets_its_odometry_while_it_is_connected(page, stack):
    """It comes into both columns by itself; without it sim2 stands, and is free."""
    app = page.context.new_page()
    app.goto(f"{stack.url}/")
    app.evaluate(APP)
    page.bring_to_front()
    _drag(page, _topic(page, "source", "app:stick", "/stick"), _topic(page, "target", "sim2"))
    driving = page.locator('[data-source="app:stick"] [data-part="state"]')
    expect(driving).to_have_text(re.compile(r"Runs, [1-9][0-9.]*/s"))
    app.evaluate("window.turn(0.5)")
    _topic(page, "source", "sim2", "/odom").click()
    _topic(page, "target", "app:stick", "/pose").click()
    # Not wait_for_function, which the page's Content-Security-Policy forbids.
    turns = "window.odometry?.twist.twist.angular.z > 0"
    stack.wait("odometry at the app", lambda: bool(app.evaluate(turns)), "relay", "sim2")
    assert _driver(stack)["user"] == "mia (route)"
    with SimWatch(stack, "sim2") as watch:
        app.close()
        watch.wait_standing()
    expect(driving).to_have_text("Waits: app stick is not connected")
    assert _driver(stack) is None

"""What a person sees of a robot on the drive page: its cameras in their places, how old they are, the map, and stills.

The simulated robot has two cameras, one in front and one above, and a moment drawn into each picture; its pixels are
read from the page's own canvases.
"""

import re
from statistics import median

import pytest
from frame_stamp import READ_STAMP
from map_pixels import SCAN, WALL, find_pixels, wait_pixels
from pages import (
    drive_live,
    expect_armed,
    expect_live,
    hide,
    wait_until,
)
from playwright.sync_api import expect
from sim_service import call_sim

ROBOT = "sim1"
FRONT, REAR, MAP = "/camera/image_raw", "/rear/image_raw", "map:"


@pytest.fixture
def robot(page, stack):
    """The robot's page, which drives, with all that it can show found."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    expect(page.get_by_test_id("camera").get_by_role("button")).to_have_count(3)
    _expect_picture(_tile(page, FRONT), "live")
    return page


def _tile(page, topic):
    if topic == MAP:
        return page.get_by_test_id("map-tile")
    return page.locator(f"[data-testid=tile][data-topic='{topic}']")


def _view(page, source):
    """The button that makes it the main one."""
    return page.get_by_test_id(f"view-{[FRONT, REAR, MAP].index(source) + 1}")


def _expect_picture(tile, state):
    expect(tile).to_have_attribute("data-frame", state)


def _expect_main(page, topic):
    expect(_tile(page, topic)).to_have_attribute("data-main", "true")


def _wait_size(canvas, width, height):
    """Wait for a picture of this size: a busy robot makes them smaller for a while."""
    canvas.page.wait_for_function(
        "([canvas, width, height]) => canvas.width === width && canvas.height === height",
        arg=[canvas.element_handle(), width, height],
        timeout=20_000,
    )


def test_the_picture_says_how_old_it_is(robot):
    """The age is that of the stamp in the picture, the rate the camera's; the parts of the round trip are told."""
    facts = _tile(robot, FRONT).get_by_test_id("tile-facts")
    expect(facts).to_contain_text(re.compile("640.480"))
    expect(facts).to_contain_text("/s")
    look = f"""() => {{
      const text = document.querySelector("[data-testid=picture-age]").textContent;
      const stamp = {READ_STAMP}(document.querySelector("[data-testid=video]"));
      return [parseFloat(text), Date.now() - stamp];
    }}"""
    looks = []
    for _ in range(9):
        looks.append(robot.evaluate(look))
        robot.wait_for_timeout(100)
    assert 0 <= median(age for age, _ in looks) < 1000
    parts = re.compile(r"\d+ ms to the server, \d+ ms on to the robot, \d+ ms in its rosbridge")
    expect(robot.get_by_test_id("rtt-parts")).to_have_text(parts, timeout=15_000)
    # The text may be a quarter of a second older than the picture, or newer; of a picture that was late, more.
    assert median(abs(age - real) for age, real in looks) < 500


def test_views_are_swapped_and_only_what_is_shown_has_a_stream(robot):
    """The page requests a small picture beside the main one; a choice of the map leaves one to drive by."""
    sockets = []
    robot.on("websocket", lambda item: "/video/frames" in item.url and sockets.append(item))
    robot.reload()
    _expect_picture(_tile(robot, FRONT), "live")
    robot.get_by_test_id("layout").select_option("inset")
    _expect_picture(_tile(robot, REAR), "live")
    assert ["rear" in socket.url for socket in sockets] == [False, True]
    small = _tile(robot, REAR).get_by_test_id("side-video")
    robot.wait_for_function(
        "canvas => canvas.width > 0 && canvas.width <= 320", arg=small.element_handle()
    )
    _wait_size(robot.get_by_test_id("video"), 640, 480)
    robot.keyboard.press("c")
    _expect_main(robot, REAR)
    _expect_picture(_tile(robot, FRONT), "live")
    robot.keyboard.press("1")
    _expect_main(robot, FRONT)
    _tile(robot, REAR).get_by_test_id("enlarge").click()
    _expect_main(robot, REAR)
    expect(_view(robot, REAR)).to_have_attribute("aria-pressed", "true")
    _view(robot, FRONT).click()
    robot.get_by_test_id("layout").select_option("one")
    wait_until(robot, "closed the second", lambda: _are_closed(sockets) == [False, True])
    _view(robot, MAP).click()
    _expect_main(robot, MAP)
    _expect_picture(_tile(robot, FRONT), "live")
    _view(robot, FRONT).click()
    expect(_tile(robot, MAP)).to_have_count(0)
    expect_armed(robot)
    hide(robot)
    wait_until(robot, "closed all", lambda: all(_are_closed(sockets)))


def _are_closed(sockets):
    return [socket.is_closed() for socket in sockets]


def test_the_map_shows_walls_and_scan(robot, stack):
    """The map's tile draws the map and the scan; what is switched off stays away."""
    # Not at a wall, to which another test may have driven it; and on a page that does not see it jump from there.
    call_sim(stack, ROBOT, "/reset")
    robot.reload()
    expect_live(robot, seconds=10)
    expect(robot.get_by_test_id("camera").get_by_role("button")).to_have_count(3)
    _view(robot, MAP).click()
    canvas = robot.get_by_test_id("video")
    robot.get_by_test_id("zoom-out").click()
    wait_pixels(canvas, SCAN, 50)
    wait_pixels(canvas, WALL, 50)
    robot.get_by_test_id("map-map").uncheck()
    robot.get_by_test_id("map-scan").uncheck()
    wait_pixels(canvas, SCAN, 0, most=0)
    _expect_scan_on_walls(robot)


def _expect_scan_on_walls(page):
    """The scan of a turned laser off the middle lies on what the map has, within four pixels: a quarter of a metre."""
    canvas = page.get_by_test_id("video")
    shown = {"scan": SCAN, "map": WALL}
    pixels = {}
    for part, colour in shown.items():
        page.get_by_test_id(f"map-{part}").check()
        wait_pixels(canvas, colour, 50)
        pixels[part] = find_pixels(canvas, colour)
        page.get_by_test_id(f"map-{part}").uncheck()
    reach = range(-4, 5)
    near = {(x + a, y + b) for x, y in pixels["map"] for a in reach for b in reach}
    astray = pixels["scan"] - near
    assert len(astray) < 0.02 * len(pixels["scan"])

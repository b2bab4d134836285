"""What a person sees of a robot on the drive page: its cameras in their places, how old they are, the map, and stills.

The simulated robot has two cameras, one in front and one above, and a moment drawn into each picture; its pixels are
read from the page's own canvases.
"""

from __future__ import annotations

import math
import re
from statistics import median

import page_holds
import pytest
from frame_stamp import READ_STAMP, read_stamp
from pages import (
    drive_live,
    expect_armed,
    expect_live,
    expect_no_sideways_scroll,
    open_drawer,
    open_live,
    wait_until,
)
from playwright.sync_api import Locator, Page, expect
from sim_service import call_sim, frozen_cameras
from sim_watch import SimWatch
from stack import Stack

ROBOT = "sim1"
FRONT, REAR, MAP = "/camera/image_raw", "/rear/image_raw", "map:"
PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
# Of driving, as the machine may make the page let go on its way.
STRETCHES = 5
# As in mapTile.js and world.js.
SCAN, PATH, WALL = (255, 107, 107), (90, 169, 255), (236, 240, 246)

HIDE = (
    "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
    "document.dispatchEvent(new Event('visibilitychange'))"
)
COUNT_PIXELS = """(canvas, [red, green, blue]) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4)
    if (Math.abs(data[i] - red) + Math.abs(data[i + 1] - green) + Math.abs(data[i + 2] - blue) < 24) count += 1;
  return count;
}"""

FIND_PIXELS = """(canvas, [red, green, blue]) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const found = [];
  for (let i = 0; i < data.length; i += 4)
    if (Math.abs(data[i] - red) + Math.abs(data[i + 1] - green) + Math.abs(data[i + 2] - blue) < 24)
      found.push([(i / 4) % canvas.width, Math.floor(i / 4 / canvas.width)]);
  return found;
}"""


@pytest.fixture
def robot(page: Page, stack: Stack) -> Page:
    """The robot's page, which drives, with all that it can show found."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    expect(page.get_by_test_id("camera").get_by_role("button")).to_have_count(3)
    _expect_picture(_tile(page, FRONT), "live")
    return page


def _tile(page: Page, topic: str) -> Locator:
    if topic == MAP:
        return page.get_by_test_id("map-tile")
    return page.locator(f"[data-testid=tile][data-topic='{topic}']")


def _view(page: Page, source: str) -> Locator:
    """The button that makes it the main one."""
    return page.get_by_test_id(f"view-{[FRONT, REAR, MAP].index(source) + 1}")


def _expect_picture(tile: Locator, state: str, seconds: float = 10) -> None:
    expect(tile).to_have_attribute("data-frame", state, timeout=seconds * 1000)


def _expect_main(page: Page, topic: str) -> None:
    expect(_tile(page, topic)).to_have_attribute("data-main", "true")


def _wait_pixels(canvas: Locator, colour: tuple[int, int, int], least: int) -> None:
    """Wait until the canvas has so many pixels of about this colour."""
    canvas.page.wait_for_function(
        f"([canvas, colour, least]) => ({COUNT_PIXELS})(canvas, colour) >= least",
        arg=[canvas.element_handle(), list(colour), least],
        timeout=10_000,
    )


def _wait_size(canvas: Locator, width: int, height: int) -> None:
    """Wait for a picture of this size: a busy robot makes them smaller for a while."""
    canvas.page.wait_for_function(
        "([canvas, width, height]) => canvas.width === width && canvas.height === height",
        arg=[canvas.element_handle(), width, height],
        timeout=20_000,
    )


def test_the_picture_says_how_old_it_is(robot: Page) -> None:
    """The one age that the page shows is that of the stamp in the picture, and the rate is the camera's."""
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
    assert 0 <= median(told for told, _ in looks) < 1000
    # The text may be a quarter of a second older than the picture, or newer; of a picture that was late, more.
    assert median(abs(told - real) for told, real in looks) < 500


def test_an_inset_shows_the_second_camera_and_keys_swap_them(robot: Page) -> None:
    """With the layout inset both cameras play; C, a number or a click makes one the main picture, and it goes on."""
    robot.get_by_test_id("layout").select_option("inset")
    _expect_picture(_tile(robot, REAR), "live")
    _expect_main(robot, FRONT)
    robot.keyboard.press("c")
    _expect_main(robot, REAR)
    expect(_tile(robot, FRONT)).to_have_attribute("data-main", "false")
    _expect_picture(_tile(robot, FRONT), "live")
    robot.keyboard.press("1")
    _expect_main(robot, FRONT)
    _tile(robot, REAR).get_by_test_id("enlarge").click()
    _expect_main(robot, REAR)
    expect(_view(robot, REAR)).to_have_attribute("aria-pressed", "true")
    expect(_view(robot, FRONT)).to_have_attribute("aria-pressed", "false")


def test_a_small_picture_is_asked_for_small(robot: Page) -> None:
    """The camera in the inset sends fewer pixels than the one that is looked at."""
    robot.get_by_test_id("layout").select_option("inset")
    # A canvas without a picture is small, too.
    _expect_picture(_tile(robot, REAR), "live")
    small = _tile(robot, REAR).get_by_test_id("side-video")
    robot.wait_for_function(
        "canvas => canvas.width > 0 && canvas.width <= 320",
        arg=small.element_handle(),
        timeout=10_000,
    )
    _wait_size(robot.get_by_test_id("video"), 640, 480)


def test_only_what_is_shown_has_a_stream(robot: Page) -> None:
    """One picture is one stream; a grid has one for each camera, and a hidden page none."""
    sockets: list[str] = []
    closed: list[str] = []

    def note(socket: object) -> None:
        url = socket.url  # type: ignore[attr-defined]
        if "/video/frames" in url:
            sockets.append(url)
            socket.on("close", lambda _: closed.append(url))  # type: ignore[attr-defined]

    robot.on("websocket", note)
    robot.reload()
    _expect_picture(_tile(robot, FRONT), "live")
    robot.get_by_test_id("layout").select_option("grid")
    _expect_picture(_tile(robot, REAR), "live")
    assert ["rear" in url for url in sockets] == [False, True]
    robot.get_by_test_id("layout").select_option("one")
    wait_until(robot, "closed the second", lambda: closed == sockets[1:])
    expect(_tile(robot, REAR)).to_have_count(0)
    robot.evaluate(HIDE)
    wait_until(robot, "closed both", lambda: len(closed) == 2)
    assert len(sockets) == 2, sockets


def test_a_picture_is_turned_and_stays_so(robot: Page, stack: Stack) -> None:
    """Turning by a quarter swaps width and height at once, and the next visit begins that way."""
    video = robot.get_by_test_id("video")
    _wait_size(video, 640, 480)
    open_drawer(robot)
    robot.get_by_test_id("turn").click()
    _wait_size(video, 480, 640)
    robot.goto(f"{stack.url}/robots/{ROBOT}")
    _expect_picture(_tile(robot, FRONT), "live")
    _wait_size(robot.get_by_test_id("video"), 480, 640)


def test_fullscreen_keeps_stick_and_stop(robot: Page, stack: Stack) -> None:
    """F makes the whole page full: Stop and stick are on the screen and work; F again ends it."""
    robot.keyboard.press("f")
    robot.wait_for_function("() => document.fullscreenElement === document.documentElement")
    for name in ("stop", "joystick", "stage", "control"):
        expect(robot.get_by_test_id(name)).to_be_in_viewport(ratio=0.9)
    with SimWatch(stack, ROBOT) as watch:
        expect_armed(robot)
        robot.keyboard.down("w")
        watch.wait_pose("moving in fullscreen", lambda pose: pose["linear_velocity"] > 0)
        robot.keyboard.up("w")
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
    robot.get_by_test_id("full").click()
    robot.wait_for_function("() => !document.fullscreenElement")


def test_fullscreen_lets_go_of_the_stick(robot: Page, stack: Stack) -> None:
    """Going to fullscreen while a key is held stops the robot, and the repeats of the key start nothing."""
    with SimWatch(stack, ROBOT) as watch:
        expect_armed(robot)
        robot.keyboard.down("w")
        watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0)
        robot.keyboard.press("f")
        robot.wait_for_function("() => document.fullscreenElement")
        watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0, seconds=2)
        robot.keyboard.up("w")


def test_choosing_the_map_holds_nothing(robot: Page, stack: Stack) -> None:
    """The camera goes on in the inset, so that there is a picture to drive by, and is alone again when it is chosen."""
    _view(robot, MAP).click()
    _expect_main(robot, MAP)
    _expect_picture(_tile(robot, FRONT), "live")
    robot.wait_for_timeout(3000)  # after which it was held for good
    expect_live(robot, seconds=10)
    with SimWatch(stack, ROBOT) as watch:
        expect_armed(robot)
        robot.keyboard.down("d")
        watch.wait_pose("turning by the map", lambda pose: pose["angular_velocity"] < 0)
        robot.keyboard.up("d")
    _view(robot, FRONT).click()
    expect(_tile(robot, MAP)).to_have_count(0)


def test_the_map_shows_walls_scan_and_the_way(robot: Page, stack: Stack) -> None:
    """The map's tile draws the map, the scan and, after a drive, the path; what is switched off stays away."""
    # Not at a wall, to which another test may have driven it; and on a page that does not see it jump from there.
    call_sim(stack, ROBOT, "/reset")
    robot.reload()
    expect_live(robot, seconds=10)
    expect(robot.get_by_test_id("camera").get_by_role("button")).to_have_count(3)
    _view(robot, MAP).click()
    canvas = robot.get_by_test_id("video")
    robot.get_by_test_id("zoom-out").click()
    _wait_pixels(canvas, SCAN, 50)
    _wait_pixels(canvas, WALL, 50)
    robot.get_by_test_id("map-map").uncheck()
    robot.get_by_test_id("map-scan").uncheck()
    robot.wait_for_function(
        f"([canvas, colour]) => ({COUNT_PIXELS})(canvas, colour) === 0",
        arg=[canvas.element_handle(), list(SCAN)],
        timeout=5000,
    )
    assert canvas.evaluate(COUNT_PIXELS, list(PATH)) == 0
    _view(robot, FRONT).click()
    _expect_picture(_tile(robot, FRONT), "live")
    _drive_ahead(robot, stack, metres=2)
    _view(robot, MAP).click()
    expect(robot.get_by_test_id("map-scan")).not_to_be_checked()
    # Two metres of 16 pixels, two pixels wide, less what the robot hides.
    _wait_pixels(robot.get_by_test_id("video"), PATH, 30)
    _expect_scan_on_walls(robot)
    call_sim(stack, ROBOT, "/reset")


def _expect_scan_on_walls(page: Page) -> None:
    """The scan of a turned laser off the middle lies on what the map has, within four pixels: a quarter of a metre."""
    canvas = page.get_by_test_id("video")
    shown = {"scan": SCAN, "map": WALL}
    pixels: dict[str, set[tuple[int, int]]] = {}
    for part, colour in shown.items():
        page.get_by_test_id(f"map-{part}").check()
        _wait_pixels(canvas, colour, 50)
        pixels[part] = {(x, y) for x, y in canvas.evaluate(FIND_PIXELS, list(colour))}
        page.get_by_test_id(f"map-{part}").uncheck()
    reach = range(-4, 5)
    near = {(x + a, y + b) for x, y in pixels["map"] for a in reach for b in reach}
    astray = pixels["scan"] - near
    assert len(astray) < 0.02 * len(pixels["scan"])


def _drive_ahead(page: Page, stack: Stack, metres: float) -> None:
    """Drive so far at least; a page that had to let go is pressed anew."""
    with SimWatch(stack, ROBOT) as watch:
        start = dict(watch.pose)

        def is_there(pose: dict[str, float]) -> bool:
            return math.hypot(pose["x"] - start["x"], pose["y"] - start["y"]) > metres

        for _ in range(STRETCHES):
            expect_armed(page)
            page_holds.note(page)
            page.keyboard.down("w")
            watch.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0)
            watch.wait_pose(
                "on its way",
                lambda pose: is_there(pose) or pose["linear_velocity"] == 0,
                seconds=20,
            )
            had_to_let_go = page_holds.had_to_let_go(page)
            page.keyboard.up("w")
            watch.wait_pose("standing", lambda pose: pose["linear_velocity"] == 0)
            if is_there(watch.pose) or not had_to_let_go:
                break
        assert is_there(watch.pose), f"from {start} only to {watch.pose}"


def test_what_is_not_seen_is_not_subscribed_to(robot: Page) -> None:
    """Scan and map come through the connection only while a map is shown, the large or the small one."""
    sent = _sent_to_ros(robot)
    robot.set_viewport_size({"width": 1280, "height": 650})  # no room for the small map
    robot.reload()
    _expect_picture(_tile(robot, FRONT), "live")
    expect(robot.get_by_test_id("small-map")).to_be_hidden()
    expect(robot.get_by_test_id("camera").get_by_role("button")).to_have_count(3)
    assert not any('"/scan"' in text for text in sent)

    def of_scan(operation: str) -> list[str]:
        return [text for text in sent if f'"{operation}"' in text and '"/scan"' in text]

    robot.keyboard.press("3")
    wait_until(robot, "subscribed", lambda: bool(of_scan("subscribe")))
    robot.keyboard.press("1")
    wait_until(robot, "unsubscribed", lambda: bool(of_scan("unsubscribe")))
    scan = of_scan("subscribe")[0]
    assert '"throttle_rate":150' in scan
    assert '"queue_length":1' in scan


def _sent_to_ros(page: Page) -> list[str]:
    sent: list[str] = []

    def note(socket: object) -> None:
        if "/ros" in socket.url:  # type: ignore[attr-defined]
            socket.on("framesent", lambda payload: sent.append(str(payload)))  # type: ignore[attr-defined]

    page.on("websocket", note)
    return sent


def test_a_still_is_saved_at_full_quality(robot: Page) -> None:
    """Save picture downloads a JPEG of the camera's own size, named after robot, camera and time."""
    open_drawer(robot)
    with robot.expect_download() as download:
        robot.get_by_test_id("still").click()
        # Now: the page says so for six seconds, and the file may take as long.
        expect(robot.get_by_test_id("sight-note")).to_have_text("Picture saved.")
    name = download.value.suggested_filename
    assert name.startswith("sim1-camera-20")
    assert name.endswith("Z.jpg")
    jpeg = download.value.path().read_bytes()
    assert jpeg[:2] == b"\xff\xd8"
    assert read_stamp(jpeg) > 1_700_000_000


def test_a_camera_that_nothing_publishes_is_named(page: Page, stack: Stack) -> None:
    """On the drive page, by what saves a still, and on the fleet page; another camera is shown all the same."""
    nowhere, rear = {"topic": "/camera/nowhere", "name": "Lost"}, {"topic": REAR, "name": "Rear"}
    why = "No frames from /camera/nowhere: the topic does not exist or nothing publishes it."
    stack.wait_until_drivable(ROBOT)
    stack.admin.set_robot(ROBOT, {"page.cameras": [nowhere, rear]})
    try:
        open_live(page, stack, ROBOT)
        expect(_tile(page, "/camera/nowhere").get_by_test_id("tile-words")).to_have_text(why)
        open_drawer(page)
        page.get_by_test_id("still").click()
        expect(page.get_by_test_id("sight-note")).to_have_text(f"Picture not saved. {why}")
        page.keyboard.press("c")
        _expect_picture(_tile(page, REAR), "live")
        page.goto(stack.url)
        thumb = page.get_by_test_id(f"robot-card-{ROBOT}").get_by_test_id("card-thumb")
        expect(thumb).to_have_text(why)
    finally:
        stack.admin.set_robot(ROBOT, {"page.cameras": None})
        stack.wait_for_changes(ROBOT)


def test_a_frozen_camera_is_grey_and_says_so(robot: Page, stack: Stack) -> None:
    """A second without a new picture greys the last one with words, its age goes on, and a new picture ends it."""
    tile = _tile(robot, FRONT)
    with frozen_cameras(stack, ROBOT):
        _expect_picture(tile, "old", seconds=5)
        expect(tile.get_by_test_id("tile-words")).to_contain_text("This video is old.")
        assert "grayscale" in robot.get_by_test_id("video").evaluate(
            "canvas => getComputedStyle(canvas).filter"
        )
        expect(robot.get_by_test_id("picture-age")).to_have_text(re.compile(r"^[2-9]\d{3} ms$"))
        expect(robot.get_by_test_id("picture-age")).to_have_attribute("data-health", "poor")
    _expect_picture(tile, "live")
    expect(tile.get_by_test_id("tile-words")).to_be_empty()


def test_a_fixed_quality_is_what_the_robot_sends(robot: Page) -> None:
    """Whoever chooses 30 % gets that from the robot, and the next visit begins with it."""
    open_drawer(robot)
    robot.get_by_test_id("quality").select_option("30")
    facts = _tile(robot, FRONT).get_by_test_id("tile-facts")
    expect(facts).to_contain_text("30 %", timeout=10_000)
    robot.reload()
    expect(robot.get_by_test_id("quality")).to_have_value("30")
    expect(facts).to_contain_text("30 %", timeout=10_000)


def test_battery_and_diagnostics_are_beside_the_picture(robot: Page, stack: Stack) -> None:
    """The battery is told in percent; a camera that freezes is a warning in the diagnostics, which a list explains."""
    expect(robot.get_by_test_id("battery")).to_contain_text(" %", timeout=10_000)
    diagnostics = robot.get_by_test_id("diagnostics")
    with frozen_cameras(stack, ROBOT):
        expect(diagnostics).to_have_attribute("data-level", "warn", timeout=10_000)
        diagnostics.locator("summary").click()
        expect(diagnostics.locator("li[data-level=warn]")).to_have_count(1)
    expect(diagnostics).to_have_attribute("data-level", "ok", timeout=10_000)


@pytest.mark.parametrize("context", [PHONE], indirect=True)
def test_nothing_of_the_view_moves_the_stick_on_a_phone(robot: Page, stack: Stack) -> None:
    """Layouts, menus and an old picture change nothing outside the picture's place."""
    stick = robot.get_by_test_id("joystick")
    place = stick.bounding_box()
    robot.get_by_test_id("layout").select_option("grid")
    _expect_picture(_tile(robot, REAR), "live")
    open_drawer(robot)
    assert stick.bounding_box() == place
    with frozen_cameras(stack, ROBOT):
        _expect_picture(_tile(robot, FRONT), "old", seconds=5)
        assert stick.bounding_box() == place
    expect_no_sideways_scroll(robot)

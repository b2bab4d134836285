"""H.264 on the drive page, where Chromium decodes what the simulated robot encodes, and in a player.

The canvas is compared with the robot's own still: valid H.264 that is never painted gives no error.
"""

import base64
import io
import json
import re

import av
import page_holds
import pytest
from frame_stamp import READ_STAMP
from pages import drive_live, open_drawer, wait_until
from PIL import Image, ImageChops, ImageStat
from playwright.sync_api import expect
from programs import Program

ROBOT, CAMERA = "sim1", "/camera/image_raw"
# Number of coarse blocks across and down, and the part of the picture above the stamp.
BLOCKS, ABOVE_STAMP = (16, 12), 0.95
# Maximum mean difference of the blocks' colours, of 255, between two codecs of one scene.
MAX_DIFFERENCE = 12


@pytest.fixture
def statuses(page):
    """What the server reports of the cameras' sources to this page."""
    collected = []

    def receive(payload):
        message = json.loads(payload) if isinstance(payload, str) else {}
        if message.get("op") == "status":
            collected.append(message)

    def follow(socket):
        if "/video/frames" in socket.url:
            socket.on("framereceived", receive)

    page.on("websocket", follow)
    return collected


def _tile(page):
    return page.locator(f"[data-testid=tile][data-topic='{CAMERA}']")


def _blocks(image):
    width, height = image.size
    box = (0, 0, width, height * ABOVE_STAMP)
    return image.convert("RGB").resize(BLOCKS, Image.Resampling.BOX, box=box)


def _canvas(page):
    url = page.get_by_test_id("video").evaluate("canvas => canvas.toDataURL('image/png')")
    return _blocks(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))))


def _still(page, stack):
    path = f"/robots/{ROBOT}/video/robotether/snapshot?topic={CAMERA}&quality=100"
    answer = page.request.get(stack.url + path)
    assert answer.ok, answer.text()
    return _blocks(Image.open(io.BytesIO(answer.body())))


def _difference(first, second):
    return sum(ImageStat.Stat(ImageChops.difference(first, second)).mean) / 3


def test_the_page_shows_h264_as_the_camera_sees_it(page, stack, statuses):
    """Canvas, still and stamp agree; details, list and seen age say what is shown."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    wait_until(
        page,
        "encoded as H.264",
        lambda: any(status["codec"] == "h264" and status["encoder"] for status in statuses),
        seconds=30,
    )
    open_drawer(page)
    facts = _tile(page).get_by_test_id("tile-facts")
    expect(facts).to_contain_text("H.264", timeout=20_000)
    expect(_tile(page)).to_have_attribute("data-frame", "live")
    page.get_by_test_id("uplink").locator("summary").click()
    row = page.get_by_test_id("uplink-list").locator(f"[data-name='{CAMERA}']")
    expect(row).to_contain_text(re.compile(r"H\.264, encoded by \w+"))

    still, canvas = _still(page, stack), _canvas(page)
    assert _difference(canvas, still) < MAX_DIFFERENCE
    # What is compared is a picture, and not one colour.
    assert _difference(canvas, canvas.transpose(Image.Transpose.FLIP_TOP_BOTTOM)) > MAX_DIFFERENCE
    stamp = f"() => {READ_STAMP}(document.querySelector('[data-testid=video]'))"
    first = page.evaluate(stamp)
    assert first is not None
    page.wait_for_function(f"first => ({stamp})() > first + 500", arg=first, timeout=10_000)

    page.keyboard.press("Escape")
    seen_age = page.get_by_test_id("seen-age")
    page_holds.hold_key(
        page, lambda: expect(seen_age).to_contain_text(re.compile(r"seen \d+ ms ago"))
    )
    page.keyboard.up("w")
    expect(facts).to_contain_text("H.264")


def test_a_player_shows_what_the_camera_sees(page, stack):
    """FFmpeg plays it with a ticket, also as a player that drops what it has probed."""
    stack.wait_until_drivable(ROBOT)
    drive_live(page, stack, ROBOT)
    ticket = Program(stack, stack.token("player")).ticket(ROBOT, "observe")
    url = f"{stack.url}/robots/{ROBOT}/video/stream?topic={CAMERA}&codec=h264&ticket={ticket}"
    options = {"fflags": "nobuffer", "probesize": "20000", "tls_verify": "0"}
    with av.open(url, options=options, timeout=30) as player:
        shown = [frame for frame, _ in zip(player.decode(video=0), range(20), strict=False)]
    assert _difference(_blocks(shown[-1].to_image()), _still(page, stack)) < MAX_DIFFERENCE

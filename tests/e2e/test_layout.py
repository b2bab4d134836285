"""The layout of the drive page: the picture first, stick and Stop whole and uncovered, and nothing moves them.

One page takes all sizes of a screen in turn, as a window does that is resized or a phone that is turned.
"""

import http.client
from contextlib import closing
from itertools import product

import pytest
from page_users import PASSWORD, PageUsers, release_all
from pages import (
    be_logged_in,
    drive_live,
    expect_live,
    expect_mode,
    expect_no_sideways_scroll,
    expect_small_map,
    open_drawer,
    open_live,
    resize,
    take_control,
)
from playwright.sync_api import expect
from sim_service import frozen_cameras

ROBOT, OBSERVER = "sim1", "olga-of-the-layout"
MOUSE = {"viewport": {"width": 1280, "height": 800}}
TOUCH = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
SIZES = {
    "mouse": [(1280, 800), (2560, 1440)],
    "touch": [(360, 740), (740, 360), (820, 1180)],
}
# What share of the screen the picture has at least; held upright it is as wide as the screen.
PICTURE = {(1280, 800): 0.7, (2560, 1440): 0.7, (740, 360): 0.5}
# Of each thing whether its corners and its middle are on the screen with nothing else over them.
UNCOVERED = """(names) => names.filter((name) => {
  const thing = document.querySelector(`[data-testid=${name}]`);
  const box = thing.getBoundingClientRect();
  // A stick is round: its corners are those of what can be touched.
  const inset = name.startsWith('joystick') ? box.width * 0.16 : 3;
  const across = [box.left + inset, box.left + box.width / 2, box.right - inset];
  const along = [box.top + inset, box.top + box.height / 2, box.bottom - inset];
  const is = (x, y) => document.elementFromPoint(x, y)?.closest(`[data-testid=${name}]`) === thing;
  return box.width < 44 || box.height < 44 || !across.every((x) => along.every((y) => is(x, y)));
})"""
# What keeps the picture from being all on the screen, with nothing over it from side to side at half its height.
HIDES_PICTURE = """() => {
  const stage = document.querySelector('[data-testid=stage]');
  const { left, right, top, bottom, width, height } = stage.getBoundingClientRect();
  const at = (share) => document.elementFromPoint(left + width * share, top + height / 2);
  const others = [0.02, 0.25, 0.5, 0.75, 0.98].map(at).filter((one) => !stage.contains(one));
  const isWhole = left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight;
  const place = `${left},${top} to ${right},${bottom} of ${innerWidth} x ${innerHeight}`;
  return [...others.map((one) => one?.outerHTML.slice(0, 200) ?? 'nothing'), ...(isWhole ? [] : [place])];
}"""
# Shows by force what somebody is asked, with its words: each alone, and both at once, which never comes.
QUESTIONS = """() => {
  const questions = [...document.querySelectorAll('.question')];
  for (const question of questions) {
    question.querySelector('[data-part=text]').textContent = 'ben asks for control.';
    const left = question.querySelector('[data-part=left]');
    if (left) left.textContent = 'If you neither reply nor drive, control passes to ben in 20 s.';
  }
  const shown = (some) => {
    for (const question of questions) question.hidden = !some.includes(question);
    const parts = some.flatMap((one) => [one, ...one.querySelectorAll('button')]);
    return parts.map((part) => {
      const box = part.getBoundingClientRect();
      const middle = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
      return { x: box.x, y: box.y, width: box.width, height: box.height, over: part.contains(middle) };
    });
  };
  const found = { alone: questions.flatMap((one) => shown([one])), together: shown(questions) };
  shown([]);
  return found;
}"""


@pytest.fixture(scope="module", params=[MOUSE, TOUCH], ids=list(SIZES))
def driven(stack, browser, request):
    """The robot's page on each kind of screen, for all of these tests: it drives and shows the map."""
    stack.wait_until_drivable(ROBOT)
    context = browser.new_context(ignore_https_errors=True, **request.param)
    be_logged_in(context, stack)
    page = context.new_page()
    drive_live(page, stack, ROBOT)
    expect_small_map(page)
    yield page
    context.close()


def _at_each_size(page, request):
    for width, height in SIZES[request.node.callspec.id]:
        resize(page, width, height)
        yield f"at {width}x{height}"


def _box(page, name):
    box = page.get_by_test_id(name).bounding_box()
    assert box is not None, f"{name} is not to be seen"
    return box


def _overlap(item, other):
    return (
        item["x"] < other["x"] + other["width"]
        and other["x"] < item["x"] + item["width"]
        and item["y"] < other["y"] + other["height"]
        and other["y"] < item["y"] + item["height"]
    )


def _places(page, request, state):
    """Where picture, stick and Stop are at each size, each whole, uncovered and as large as it should be."""
    places = {}
    for size in _at_each_size(page, request):
        where = f"{state} {size}"
        expect_no_sideways_scroll(page)
        assert page.evaluate(UNCOVERED, ["joystick", "stop"]) == [], where
        assert page.evaluate(HIDES_PICTURE) == [], where
        assert page.evaluate("document.scrollingElement.scrollHeight <= innerHeight"), where
        stage, screen = _box(page, "stage"), page.viewport_size
        share = stage["width"] * stage["height"] / (screen["width"] * screen["height"])
        least = PICTURE.get((screen["width"], screen["height"]))
        assert stage["width"] == screen["width"] if least is None else share >= least, where
        for name in ("joystick", "stop"):
            assert not _overlap(stage, _box(page, name)), where
        places[size] = [stage, _box(page, "joystick"), _box(page, "stop")]
    return places


def test_stick_and_stop_are_whole_as_of_a_laptop_at_400_percent(driven):
    resize(driven, 320, 256)
    assert driven.evaluate(UNCOVERED, ["joystick", "stop"]) == []


def test_picture_stick_and_stop_are_whole_in_every_state_and_keep_their_place(
    driven, stack, browser, request
):
    """Driving, watching, asked, held, without a picture, stopped and offline: nothing covers, scrolls or moves them."""
    before = _places(driven, request, "driving")
    driven.get_by_test_id("control-leave").click()
    expect_mode(driven, "observe")
    assert _places(driven, request, "watching") == before
    driven.get_by_test_id("control-drive").click()
    expect_mode(driven, "drive")
    # Another one at each kind of screen, as the server lets nobody ask again and again.
    name = f"ludwig-{request.node.callspec.id}"
    with closing(PageUsers(stack, browser)) as people:
        people.let(name, "drive", ROBOT)
    headers = {"Authorization": f"Bearer {stack.token('layout', user=name)}"}
    lease = f"/api/v1/robots/{ROBOT}/lease"
    status, answer = stack.request("POST", lease, {"action": "ask"}, headers)
    assert status == http.client.OK, answer
    expect(driven.get_by_test_id("question")).to_be_visible()
    assert _places(driven, request, "asked") == before
    stack.request("POST", lease, {"action": "withdraw"}, headers)
    expect(driven.get_by_test_id("question")).to_be_hidden()
    state = driven.get_by_test_id("state")
    with frozen_cameras(stack, ROBOT):
        expect(state).to_have_attribute("data-shown", "held")
        assert _places(driven, request, "held") == before
        driven.get_by_test_id("state-action").click()
        expect(state).to_have_attribute("data-shown", "blind")
        assert _places(driven, request, "without a picture") == before
    expect_live(driven, seconds=10)
    try:
        driven.get_by_test_id("stop").click()
        expect(driven.get_by_test_id("release")).to_be_visible()
        assert _places(driven, request, "stopped") == before
        release = driven.evaluate(UNCOVERED, ["release"])
        assert release == []
    finally:
        release_all(stack, [ROBOT])
    driven.context.set_offline(True)
    expect(state).to_have_attribute("data-shown", "server_unreachable", timeout=30_000)
    assert _places(driven, request, "offline") == before
    driven.context.set_offline(False)
    expect_live(driven, seconds=20)
    take_control(driven)


def test_who_may_not_drive_has_as_large_a_stop(driven, stack, browser, request):
    """The map is beside it; at 200 % and on a small phone both keep what they need, without room for the map."""
    with closing(PageUsers(stack, browser)) as people:
        people.let(OBSERVER, "observe", ROBOT)
    options = request.node.callspec.params["driven"]
    with closing(browser.new_context(ignore_https_errors=True, **options)) as context:
        be_logged_in(context, stack, OBSERVER, PASSWORD)
        watching = context.new_page()
        open_live(watching, stack, ROBOT)
        expect_small_map(watching)
        for name in ("joystick", "buttons"):
            expect(watching.get_by_test_id(name)).to_have_count(0)
        expect(watching.get_by_test_id("control-ask")).to_be_hidden()
        for width, height in SIZES[request.node.callspec.id]:
            for page in (driven, watching):
                resize(page, width, height)
            assert _box(watching, "stop") == _box(driven, "stop"), f"at {width}x{height}"
            assert watching.evaluate(UNCOVERED, ["stop"]) == [], f"at {width}x{height}"
            assert not _overlap(_box(watching, "observing"), _box(watching, "stop"))
        pages = ((driven, ["joystick", "stop"]), (watching, ["stop"]))
        for size, (page, names) in product(((640, 400), (568, 320)), pages):
            resize(page, *size)
            expect_no_sideways_scroll(page)
            expect(page.get_by_test_id("small-map")).to_have_attribute("data-shown", "false")
            assert page.evaluate(UNCOVERED, names) == []
            assert not _overlap(_box(page, "control"), _box(page, "stop"))


def test_a_question_covers_neither_stick_nor_stop_and_nothing_lies_over_it(driven, request):
    """Each, and where they fit both at once, which never comes; nothing else of the picture's lies over them."""
    expect(driven.get_by_test_id("battery")).to_contain_text("%")
    resize(driven, *SIZES[request.node.callspec.id][-1])
    has_keys = request.node.callspec.id == "mouse"
    expect(driven.get_by_test_id("stop").locator("kbd")).to_be_visible(visible=has_keys)
    expect(driven.get_by_text("Space = Stop")).to_be_visible(visible=has_keys)
    open_drawer(driven)
    driven.get_by_test_id("two-sticks").click()
    for size in _at_each_size(driven, request):
        assert not _overlap(_box(driven, "control"), _box(driven, "drawer")), size
        if _has_room_for_drawer(driven):
            for name in ("layout", "full"):
                assert not _overlap(_box(driven, name), _box(driven, "drawer")), f"{size} {name}"
        found = driven.evaluate(QUESTIONS)
        boxes = found["alone"]
        if driven.viewport_size is not None and driven.viewport_size["height"] > 740:
            boxes += found["together"]
        assert len(boxes) >= 6
        for box in boxes:
            assert min(box["width"], box["height"]) > 40, f"{size} a question does not show"
            assert box["over"], f"{size} something lies over a question"
            for name in ("joystick", "joystick-turn", "stop"):
                assert not _overlap(box, _box(driven, name)), f"{size} it covers {name}"
        for name in ("joystick", "joystick-turn", "stop"):
            assert driven.evaluate(UNCOVERED, [name]) == [], f"{size} {name}, with the drawer open"
    # A short phone has the least room for two sticks, also held sideways.
    for size in ((360, 640), (568, 320)):
        resize(driven, *size)
        assert driven.evaluate(UNCOVERED, ["joystick", "joystick-turn", "stop"]) == []
    driven.get_by_test_id("two-sticks").click()
    driven.get_by_test_id("drawer-open").click()


def _has_room_for_drawer(page):
    screen = page.viewport_size
    return screen["width"] >= 600  # else it lies over the whole picture


def test_the_stick_is_on_the_side_that_its_driver_chose_also_after_a_reload(driven, request):
    """Whole and uncovered there, as Stop is; the speed that was chosen is there after a reload, too."""
    left = [_box(driven, "joystick")["x"] for _ in _at_each_size(driven, request)]
    open_drawer(driven)
    driven.get_by_test_id("stick-right").click()
    driven.get_by_test_id("speed-slow").click()
    for size, before in zip(_at_each_size(driven, request), left, strict=True):
        assert _box(driven, "joystick")["x"] > before, size
        assert driven.evaluate(UNCOVERED, ["joystick", "stop"]) == [], size
    driven.reload()
    for choice in ("stick-right", "speed-slow"):
        expect(driven.get_by_test_id(choice)).to_have_attribute("aria-pressed", "true")


@pytest.mark.parametrize("has_javascript", [False, True])
def test_without_its_script_the_page_says_so_and_shows_no_dead_stop(
    stack, page, browser, has_javascript
):
    """Nothing that would do nothing is there, also when the script did not arrive; the way back to the robots is."""
    state = page.context.storage_state()
    plain = browser.new_context(
        ignore_https_errors=True, java_script_enabled=has_javascript, storage_state=state
    )
    plain.route("**/dist/drive.js*", lambda route: route.abort())
    try:
        dead = plain.new_page()
        dead.goto(f"{stack.url}/robots/{ROBOT}")
        words = dead.get_by_test_id("unscripted")
        expect(words).to_be_visible()
        expect(words).to_contain_text("Driving and stopping need this page's script")
        for name in ("stop", "state", "control", "joystick", "stage"):
            expect(dead.get_by_test_id(name)).to_be_hidden()
        expect(dead.get_by_role("link", name="Robots").first).to_be_visible()
    finally:
        plain.close()

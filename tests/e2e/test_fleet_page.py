"""The fleet page with 500 robots: found at once, and on a phone."""

import re

import pytest
from page_users import release_all
from pages import expect_no_sideways_scroll, open_page
from playwright.sync_api import expect

CROWD = 500
MEASURED = re.compile(
    r"No machine that answers is clearly nearer to you than this one \(\d+ ms\)\."
    r"|Machine other is nearer to you: \d+ ms, this one \d+ ms\. Open other"
)
SIMS = ("sim1", "sim2", "sim3")
PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
# Of the range that is kept for documentation: no machine has such a MAC.
INSERT = (
    "INSERT INTO robots (mac, name, state, site_id) SELECT "
    "CONCAT('00:00:5e:00:', LPAD(HEX(seq DIV 256 + 80), 2, '0'), ':', LPAD(HEX(seq MOD 256), 2, '0')), "
    "CONCAT('crowd-', LPAD(seq, 3, '0')), 'active', "
    "(SELECT id FROM sites WHERE name = IF(seq % 2, 'odd', 'even')) "
    f"FROM seq_0_to_{CROWD - 1}"
)


@pytest.fixture(scope="module")
def _crowd(stack):
    """500 robots more, at two sites, which are offline."""
    for site in ("odd", "even"):
        stack.admin.ask("POST", "/sites", {"name": site})
    stack.sql(INSERT)
    yield
    stack.sql("DELETE FROM robots WHERE name LIKE 'crowd-%'")
    for site in ("odd", "even"):
        stack.admin.remove("sites", site)


@pytest.fixture
def fleet(page, stack, _crowd):
    """The admin's fleet page, which has heard of all robots."""
    # A test before may have switched one off and on.
    for robot in SIMS:
        stack.wait_until_drivable(robot)
    open_page(page, stack, "/")
    expect(page.get_by_test_id("fleet-count")).to_have_text(
        f"3 of {CROWD + 3} online", timeout=15_000
    )
    # So much the server wrote into the page. Round trips are of the events, and come in one frame with all the rest.
    expect(_card(page, "sim1").locator("[data-part=rtt]")).to_contain_text("ms")
    return page


@pytest.fixture
def _released(stack):
    """The test may stop robots; afterwards none of them is stopped."""
    yield
    release_all(stack, ["sim1"])


def _card(page, name):
    return page.get_by_test_id(f"robot-card-{name}")


def _shown(page):
    return page.evaluate(
        "[...document.querySelectorAll('[data-list]:not([hidden]) [data-robot]')]"
        ".filter((one) => !one.hidden).map((one) => one.dataset.robot)"
    )


@pytest.mark.usefixtures("_released")
def test_robots_are_found_sorted_and_shown_as_the_address_says(fleet, stack):
    """The page shows cards or a table, and remembers which."""
    fleet.get_by_test_id("fleet-search").fill("sim")
    fleet.get_by_test_id("show-online").click()
    fleet.get_by_test_id("fleet-sort").select_option("name")
    expect(fleet).to_have_url(f"{stack.url}/?q=sim&show=online&sort=name")
    assert _shown(fleet) == ["sim1", "sim2", "sim3"]
    open_page(fleet, stack, "/?q=crowd-49&site=odd&sort=-name")
    expect(fleet.get_by_test_id("fleet-count")).to_contain_text("5 shown")
    assert _shown(fleet) == [f"crowd-49{place}" for place in (9, 7, 5, 3, 1)]
    open_page(fleet, stack, "/?q=sim")
    fleet.get_by_test_id("view-table").click()
    fleet.get_by_test_id("sort-name").press("Enter")
    header = fleet.get_by_role("columnheader", name="Name")
    expect(header).to_have_attribute("aria-sort", "ascending")
    fleet.reload()
    row = fleet.get_by_test_id("robot-row-sim1")
    expect(row).to_contain_text("Online since")
    fleet.get_by_test_id("show-stopped").click()
    expect(row).to_be_hidden()
    stack.admin.ask("POST", "/robots/sim1/stop", {})
    expect(row.get_by_test_id("row-stopped")).to_contain_text("Stopped by admin at")
    fleet.get_by_test_id("view-cards").click()
    expect(_card(fleet, "sim1").get_by_test_id("card-stopped")).to_contain_text("Stopped by admin")
    expect(_card(fleet, "sim3")).to_be_hidden()


@pytest.mark.parametrize("context", [PHONE], indirect=True, ids=["phone"])
def test_the_fleet_fits_a_phone(fleet):
    """Neither view scrolls sideways, Stop stays on the screen, and one button unfolds the filters."""
    expect_no_sideways_scroll(fleet)
    fleet.evaluate("scrollTo(0, document.body.scrollHeight)")
    expect(fleet.get_by_test_id("stop-all")).to_be_in_viewport(ratio=1)
    fleet.evaluate("scrollTo(0, 0)")
    expect(fleet.get_by_test_id("show-online")).to_be_hidden()
    fleet.get_by_test_id("fleet-filters").click()
    expect(fleet.get_by_test_id("show-online")).to_be_visible()
    fleet.get_by_test_id("fleet-search").fill("sim1")
    expect(_card(fleet, "sim1").get_by_test_id("card-stop")).to_be_visible()
    fleet.get_by_test_id("view-table").click()
    expect(fleet.get_by_test_id("robot-row-sim1").get_by_test_id("card-stop")).to_be_in_viewport()
    box = fleet.get_by_test_id("robot-row-sim1").get_by_test_id("card-stop").bounding_box()
    assert box["x"] + box["width"] <= 360
    assert box["height"] >= 44


def test_other_machines_are_measured(page, stack):
    """The browser may ask them: here the same nginx, by its address, which counts as another machine.

    Which of the two is nearer is up to the moment.
    """
    stack.sql(
        "INSERT INTO cells (name, host, https_port, ssh_ports, version, heartbeat_at)"
        f" VALUES ('other', '127.0.0.1', {stack.https_port}, '1', '0', NOW() + INTERVAL 4 SECOND)"
    )
    try:
        there = f"https://127.0.0.1:{stack.https_port}/nginx-health"
        with page.expect_response(there) as answer:
            open_page(page, stack, "/")
        assert answer.value.ok
        expect(page.get_by_test_id("nearest")).to_have_text(MEASURED)
    finally:
        stack.sql("DELETE FROM cells WHERE name = 'other'")

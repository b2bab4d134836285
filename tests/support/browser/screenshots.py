"""`make screenshots`: pictures of the pages of the running demo, into tests/artifacts; README's goes into docs.

A machine that waits, a join token, a second driver, an observer and buttons are made for the pictures, and removed
again; sim1's cameras freeze, it is stopped and released, and sim3 is switched off and on.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus

from demo import ROOT, Demo
from local_network import request_json
from pages import (
    Site,
    answer,
    chromium,
    expect_live,
    log_in,
    open_drawer,
    open_page,
    take_control,
)
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright
from robot_signer import RobotSigner
from sim_service import frozen_cameras

FOLDER = ROOT / "tests" / "artifacts" / "screenshots"
README_SHOWS = "drive-desktop-light.png"
# Of these the page "Driving" shows the top, where the state stands.
STATES = ("drive-observing", "drive-held", "drive-stopped")
TOP = (0, 0, 1280, 150)
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}
LOOKS = (("desktop", "light"), ("phone", "dark"))
# The pictures are kept in the repository. A camera has more colours than the pages, whose few must stay.
COLOURS = 256
# Of the range that is kept for documentation: no machine has it.
STRANGERS_MAC, STRANGERS_NAME = "00:00:5e:00:53:01", "robot-005301"
SECOND_DRIVER, OBSERVER = "ben-of-pictures", "olga-of-pictures"
BUTTONS = [
    {"name": "Lights on", "kind": "publish", "topic": "/lights", "type": "std_msgs/Bool", "msg": {"data": True}},
    {"name": "Dock", "kind": "call", "service": "/dock", "type": "std_srvs/Trigger", "args": {}, "confirm": True},
]  # fmt: skip
BUTTONS_POLICY = {"drive": {"publish": ["/lights"], "call": ["/dock"]}}
ADMIN_PAGES = {
    "robots": "/admin/robots",
    "add-robot": "/admin/add-robot",
    "robot": "/admin/robots/sim1",
    "robot-access": "/admin/robots/sim1/access",
    "robot-history": "/admin/robots/sim1/history",
    "settings-safety": "/robots/sim1/settings",
    "settings-cameras": "/robots/sim1/settings/cameras",
    "settings-driving": "/robots/sim1/settings/driving",
    "settings-buttons": "/robots/sim1/settings/buttons",
    "settings-permissions": "/robots/sim1/settings/permissions",
    "remove": "/admin/robots/sim1/remove",
    "users": "/admin/users",
    "user": "/admin/users/admin",
    "tokens": "/admin/tokens",
    "groups": "/admin/groups",
    "sites": "/admin/sites",
    "drives": "/drives",
    "audit": "/admin/audit",
    "backups": "/admin/backups",
    "profile": "/profile",
    "unknown": "/robots/nobody",
}


def drive_a_little(page: Page) -> None:
    """Hold W and A for two seconds, so that the picture shows a robot that moves."""
    page.keyboard.down("w")
    page.keyboard.down("a")
    page.wait_for_timeout(2000)


@dataclass(frozen=True)
class Camera:
    """Takes pictures of one page at one size and colour scheme."""

    page: Page
    site: Site
    look: str

    def shoot(self, name: str, *, whole: bool = False) -> None:
        """Take a picture of what is on the screen, or of the whole page."""
        path = FOLDER / f"{name}-{self.look}.png"
        self.page.screenshot(path=path, full_page=whole)
        Image.open(path).convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(
            path, optimize=True
        )

    def open(self, path: str) -> None:
        open_page(self.page, self.site, path)

    def confirm_action(self, path: str) -> None:
        """Say yes on a page that asks."""
        self.open(path)
        self.page.get_by_test_id("deed-do").click()
        self.page.wait_for_selector("[data-testid=done]")


def shoot_fleet(camera: Camera) -> None:
    """Login, and the fleet as cards and as a table."""
    page = camera.page
    camera.open("/login")
    camera.shoot("login")
    log_in(page, camera.site)
    page.wait_for_selector('[data-testid=robot-card-sim1][data-online="true"]')
    page.wait_for_timeout(1500)  # round trips arrive with the live feed
    page.get_by_test_id("view-table").click()
    camera.shoot("fleet-table")
    page.get_by_test_id("view-cards").click()
    camera.shoot("fleet")


def open_to_drive(camera: Camera) -> None:
    """Open sim1 and wait until there is something to drive by."""
    camera.open("/robots/sim1")
    expect_live(camera.page, seconds=30)
    take_control(camera.page)
    camera.page.wait_for_selector('[data-testid=joystick][data-armed="true"]')


def shoot_driving(camera: Camera) -> None:
    """The drive page as it is driven by, and what unfolds on it."""
    page = camera.page
    open_to_drive(camera)
    drive_a_little(page)
    camera.shoot("drive")
    page.keyboard.up("w")
    page.keyboard.up("a")
    for layout in ("inset", "grid"):
        page.get_by_test_id("layout").select_option(layout)
        page.wait_for_timeout(1000)  # the new stream's first pictures
        camera.shoot(f"drive-{layout}")
    page.get_by_test_id("layout").select_option("one")
    open_drawer(page)
    page.get_by_test_id("two-sticks").click()
    camera.shoot("drive-two-sticks")
    page.get_by_test_id("two-sticks").click()
    page.get_by_test_id("gamepad-open").click()
    camera.shoot("drive-gamepad")
    page.get_by_test_id("gamepad-open").click()
    page.get_by_test_id("topics").locator("summary").click()
    page.get_by_test_id("topic-list").get_by_role("button", name="/odom").first.click()
    page.wait_for_timeout(2500)  # for a rate and a line
    page.get_by_test_id("topics").scroll_into_view_if_needed()
    camera.shoot("drive-topics")
    page.get_by_test_id("topics").locator("summary").click()
    page.get_by_test_id("drawer-open").click()


def shoot_states(camera: Camera, demo: Demo, observer: Page) -> None:
    """What the page says when it is not as it should be."""
    page = camera.page
    state = page.locator
    open_to_drive(camera)
    with frozen_cameras(demo, "sim1"):
        state('[data-testid=state][data-shown="held"]').wait_for()
        camera.shoot("drive-held")
        page.get_by_test_id("state-action").click()
        state('[data-testid=state][data-shown="blind"]').wait_for()
        camera.shoot("drive-blind")
    page.wait_for_selector('[data-testid=joystick][data-armed="true"]')
    page.context.set_offline(True)
    page.wait_for_selector('[data-testid=state]:not([data-shown="live"])')
    camera.shoot("drive-offline")
    page.context.set_offline(False)
    expect_live(page, seconds=30)
    other = Camera(observer, camera.site, camera.look)
    other.open("/robots/sim1")
    expect_live(observer, seconds=30)
    observer.wait_for_timeout(1000)  # for a picture
    other.shoot("drive-observing")
    demo.container("sim3").stop(timeout=5)
    try:
        other.open("/robots/sim3")
        observer.locator('[data-testid=state][data-shown="offline"]').wait_for()
        other.shoot("drive-robot-offline")
    finally:
        demo.container("sim3").start()


def shoot_summary(camera: Camera) -> None:
    """What is told of a drive when it has ended."""
    page = camera.page
    open_to_drive(camera)
    drive_a_little(page)
    page.keyboard.up("w")
    page.keyboard.up("a")
    page.get_by_test_id("control-leave").click()
    # On a phone the summary stays folded.
    page.wait_for_selector("[data-testid=summary-save]:not([hidden])", state="attached")
    camera.shoot("drive-summary")
    page.get_by_test_id("control-drive").click()
    page.wait_for_selector('[data-testid=joystick][data-armed="true"]')


def hold(page: Page, test_id: str, ms: float) -> None:
    page.get_by_test_id(test_id).hover()
    page.mouse.down()
    page.wait_for_timeout(ms)
    page.mouse.up()


def shoot_control(camera: Camera, second: Page) -> None:
    """Two people and one robot; the camera's page drives when this begins."""
    page = camera.page
    page.get_by_test_id("control").and_(page.locator("[data-mode=drive]")).wait_for()
    second.goto(f"{camera.site.url}/robots/sim1")
    other = Camera(second, camera.site, camera.look)
    second.get_by_test_id("control-ask").wait_for()
    other.shoot("drive-second")
    second.get_by_test_id("control-ask").click()
    page.get_by_test_id("question").wait_for()
    camera.shoot("drive-asked")
    other.shoot("drive-asking")
    answer(page, "hand-over")
    second.get_by_test_id("control-arm").wait_for()
    other.shoot("drive-arrived")
    page.get_by_test_id("control-take").click()
    camera.shoot("drive-take")
    answer(page, "take-yes")
    page.get_by_test_id("control-leave").wait_for()


def shoot_stop(camera: Camera) -> None:
    """A stopped robot, on its page and among the others; released again."""
    page = camera.page
    page.get_by_test_id("stop").click()
    page.wait_for_selector('[data-testid=stop-bar][data-stop="stopped"]')
    expect_live(page, seconds=10)
    camera.shoot("drive-stopped")
    camera.open("/")
    page.wait_for_selector('[data-testid=robot-card-sim1][data-stop="stopped"]')
    camera.shoot("fleet-stopped")
    camera.open("/robots/sim1")
    page.get_by_test_id("release").wait_for()
    hold(page, "release", 1200)
    page.wait_for_selector('[data-testid=stop-bar][data-stop="none"]')


def shoot_admin_pages(camera: Camera) -> None:
    """The admin's pages and the profile, as long as they are."""
    for name, path in ADMIN_PAGES.items():
        camera.open(path)
        camera.shoot(name, whole=True)
    page = camera.page
    camera.open("/admin/add-robot")
    page.get_by_test_id("token-make").click()
    try:
        page.wait_for_selector("[data-testid=install-line]")
        camera.shoot("install-line", whole=True)
    finally:
        camera.open("/admin/add-robot")
        page.get_by_test_id("advanced").locator("> summary").click()
        page.get_by_role("link", name="Revoke join token").first.click()
        page.get_by_test_id("deed-do").click()
        page.wait_for_selector("[data-testid=done]")


@contextmanager
def a_stranger(site: Site, browser: Browser) -> Iterator[None]:
    """A machine that waits for approval, until the pictures are taken."""
    status, _ = request_json("POST", f"{site.url}/api/v1/join", RobotSigner(1).join(STRANGERS_MAC))
    assert status in (HTTPStatus.OK, HTTPStatus.ACCEPTED)
    try:
        yield
    finally:
        page = browser.new_page(ignore_https_errors=True)
        log_in(page, site)
        Camera(page, site, "").confirm_action(f"/admin/robots/{STRANGERS_NAME}/remove")
        page.close()


@contextmanager
def a_user(demo: Demo, name: str, level: str) -> Iterator[str]:
    """A user with a grant for all robots' pictures, until they are taken; gives the password."""
    robotether = ("exec", "-T", "web", "robotether")
    password = demo.compose(*robotether, "user", "add", name).split()[-1]
    try:
        for robot in ("sim1", "sim3"):
            demo.compose(*robotether, "grant", name, robot, level)
        yield password
    finally:
        demo.compose(*robotether, "user", "remove", name, "--yes")


@contextmanager
def buttons(demo: Demo) -> Iterator[None]:
    """Buttons on sim1's page, until the pictures are taken."""
    before = demo.ask("GET", "/api/v1/robots/sim1")["settings"]
    given = {**before, "policy": BUTTONS_POLICY, "buttons": BUTTONS}
    demo.ask("PATCH", "/api/v1/robots/sim1", {"settings": given})
    try:
        yield
    finally:
        demo.ask("PATCH", "/api/v1/robots/sim1", {"settings": before})


def new_context(browser: Browser, size: str, scheme: str) -> BrowserContext:
    """A browser of its own at one size and colour scheme."""
    width, height = SIZES[size]
    return browser.new_context(
        ignore_https_errors=True,
        viewport={"width": width, "height": height},
        has_touch=size == "phone",
        color_scheme="dark" if scheme == "dark" else "light",
    )


def shoot_all(
    browser: Browser, demo: Demo, look: tuple[str, str], passwords: tuple[str, str]
) -> None:
    """Every page at one size and colour scheme; the second driver and the observer have the passwords."""
    contexts = [new_context(browser, *look) for _ in range(3)]
    first, second, observer = (context.new_page() for context in contexts)
    camera = Camera(first, demo, "-".join(look))
    for page, name, password in zip(
        (second, observer), (SECOND_DRIVER, OBSERVER), passwords, strict=True
    ):
        log_in(page, demo, name, password)
    shoot_fleet(camera)
    shoot_driving(camera)
    shoot_states(camera, demo, observer)
    shoot_summary(camera)
    shoot_control(camera, second)
    shoot_stop(camera)
    shoot_admin_pages(camera)
    for context in contexts:
        context.close()


def keep_for_documents() -> None:
    documents = ROOT / "docs" / "screenshots"
    shutil.copy2(FOLDER / README_SHOWS, documents)
    for name in STATES:
        top = Image.open(FOLDER / f"{name}-desktop-light.png").crop(TOP)
        top.save(documents / f"{name}.png", optimize=True)


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    demo = Demo()
    with sync_playwright() as playwright:
        browser = chromium(playwright)
        with (
            a_stranger(demo, browser),
            a_user(demo, SECOND_DRIVER, "drive") as driver,
            a_user(demo, OBSERVER, "observe") as observer,
            buttons(demo),
        ):
            for look in LOOKS:
                shoot_all(browser, demo, look, (driver, observer))
        browser.close()
    keep_for_documents()
    sys.stdout.write(f"pictures are in {FOLDER.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()

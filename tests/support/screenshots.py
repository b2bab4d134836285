"""`make screenshots`: pictures of the pages over the running demo, at desktop and phone size, for people to see.

A machine that waits, a join token and a second driver are made for the pictures, and removed again; sim1 is stopped and
released.
"""

from __future__ import annotations

import json
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from demo import ROOT, Demo
from local_network import insecure_tls
from pages import Site, chromium, expect_live, log_in, open_page
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

FOLDER = ROOT / "tests" / "artifacts" / "screenshots"
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}
# Of the range that is kept for documentation: no machine has it.
STRANGERS_MAC, STRANGERS_NAME = "00:00:5e:00:53:01", "robot-005301"
SECOND_DRIVER = "ben-of-pictures"
STRANGERS_KEY = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAB"
ADMIN_PAGES = {
    "robots": "/admin/robots",
    "pending": "/admin/pending",
    "robot": "/admin/robots/sim1",
    "robot-settings": "/admin/robots/sim1/settings",
    "remove": "/admin/robots/sim1/remove",
    "users": "/admin/users",
    "user": "/admin/users/admin",
    "join-tokens": "/admin/join-tokens",
    "tokens": "/admin/tokens",
    "groups": "/admin/groups",
    "sites": "/admin/sites",
    "drives": "/drives",
    "audit": "/admin/audit",
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
        self.page.screenshot(path=FOLDER / f"{name}-{self.look}.png", full_page=whole)

    def open(self, path: str) -> None:
        """Go to a page."""
        open_page(self.page, self.site, path)

    def do_deed(self, path: str) -> None:
        """Say yes on a page that asks."""
        self.open(path)
        self.page.get_by_test_id("deed-do").click()
        self.page.wait_for_selector("[data-testid=done]")


def shoot_driving(camera: Camera) -> None:
    """Login, fleet and drive page."""
    page = camera.page
    camera.open("/login")
    camera.shoot("login")
    log_in(page, camera.site)
    page.wait_for_selector('[data-testid=robot-card-sim1][data-online="true"]')
    page.wait_for_timeout(1500)  # round trips arrive with the live feed
    camera.shoot("fleet")
    camera.open("/robots/sim1")
    expect_live(page, seconds=30)
    page.wait_for_function("document.querySelector('[data-testid=tile][data-picture=live]')")
    drive_a_little(page)
    camera.shoot("drive")


def hold(page: Page, test_id: str, ms: float) -> None:
    """Hold a button with the mouse."""
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
    page.get_by_test_id("hand-over").click()
    second.get_by_test_id("control-arm").wait_for()
    other.shoot("drive-arrived")
    page.get_by_test_id("control-take").click()
    camera.shoot("drive-take")
    page.get_by_test_id("take-yes").click()
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
    page, token = camera.page, f"picture {camera.look}"
    camera.open("/admin/join-tokens")
    page.get_by_label("Name").fill(token)
    page.get_by_test_id("token-make").click()
    page.wait_for_selector("[data-testid=install-line]")
    camera.shoot("install-line", whole=True)
    camera.open("/admin/join-tokens")
    page.get_by_role("link", name=f"Delete join token {token}").click()
    page.get_by_test_id("deed-do").click()
    page.wait_for_selector("[data-testid=done]")


@contextmanager
def a_stranger(site: Site, browser: Browser) -> Iterator[None]:
    """A machine that waits for approval, until the pictures are taken."""
    body = {
        "mac": STRANGERS_MAC,
        "public_key": STRANGERS_KEY,
        "hostname": "turtle",
        "agent_version": "0.1.0",
    }
    request = urllib.request.Request(
        f"{site.url}/api/v1/join",
        data=json.dumps(body).encode(),
        headers={"Content-Type": "application/json"},
    )
    urllib.request.urlopen(request, timeout=10, context=insecure_tls()).close()
    try:
        yield
    finally:
        page = browser.new_page(ignore_https_errors=True)
        log_in(page, site)
        Camera(page, site, "").do_deed(f"/admin/robots/{STRANGERS_NAME}/remove")
        page.close()


@contextmanager
def a_second_driver(demo: Demo) -> Iterator[str]:
    """A user who may drive sim1, until the pictures are taken; gives the password."""
    robotether = ("exec", "-T", "web", "robotether")
    password = demo.compose(*robotether, "user", "add", SECOND_DRIVER).split()[-1]
    try:
        demo.compose(*robotether, "grant", SECOND_DRIVER, "sim1", "drive")
        yield password
    finally:
        demo.compose(*robotether, "user", "remove", SECOND_DRIVER, "--yes")


def new_context(browser: Browser, size: str, scheme: str) -> BrowserContext:
    """A browser of its own at one size and colour scheme."""
    width, height = SIZES[size]
    return browser.new_context(
        ignore_https_errors=True,
        viewport={"width": width, "height": height},
        has_touch=size == "phone",
        color_scheme="dark" if scheme == "dark" else "light",
    )


def shoot_all(browser: Browser, site: Site, look: tuple[str, str], password: str) -> None:
    """Every page at one size and colour scheme; the second driver has the password."""
    context, others = new_context(browser, *look), new_context(browser, *look)
    camera = Camera(context.new_page(), site, "-".join(look))
    second = others.new_page()
    log_in(second, site, SECOND_DRIVER, password)
    shoot_driving(camera)
    shoot_control(camera, second)
    shoot_stop(camera)
    shoot_admin_pages(camera)
    others.close()
    context.close()


def main() -> None:
    """Take all pictures and say where they are."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    demo = Demo()
    with sync_playwright() as playwright:
        browser = chromium(playwright)
        with a_stranger(demo, browser), a_second_driver(demo) as password:
            for size in SIZES:
                for scheme in ("light", "dark"):
                    shoot_all(browser, demo, (size, scheme), password)
        browser.close()
    sys.stdout.write(f"pictures are in {FOLDER.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()

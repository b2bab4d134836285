"""`make screenshots`: pictures of the pages of the running demo, into tests/artifacts; the documents' go into docs.

An observer is made for the pictures and removed again; sim1's cameras freeze, it is stopped and released. What needs
more people or other data, tests/e2e looks at.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from demo import ROOT, Demo
from pages import Site, chromium, expect_live, log_in, open_page, take_control
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright
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
OBSERVER = "olga-of-pictures"
PAGES = {
    "fleet": "/",
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
        path = FOLDER / f"{name}-{self.look}.png"
        self.page.screenshot(path=path, full_page=whole)
        Image.open(path).convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(
            path, optimize=True
        )

    def open(self, path: str) -> None:
        open_page(self.page, self.site, path)


def shoot_driving(camera: Camera, demo: Demo, observer: Page) -> None:
    """The drive page while somebody drives and watches, held by old video, and stopped."""
    page = camera.page
    camera.open("/robots/sim1")
    expect_live(page, seconds=30)
    take_control(page)
    page.wait_for_selector('[data-testid=joystick][data-armed="true"]')
    drive_a_little(page)
    camera.shoot("drive")
    page.keyboard.up("w")
    page.keyboard.up("a")
    other = Camera(observer, camera.site, camera.look)
    other.open("/robots/sim1")
    expect_live(observer, seconds=30)
    observer.wait_for_timeout(1000)  # for a picture
    other.shoot("drive-observing")
    with frozen_cameras(demo, "sim1"):
        page.wait_for_selector('[data-testid=state][data-shown="held"]')
        camera.shoot("drive-held")
    page.wait_for_selector('[data-testid=joystick][data-armed="true"]')
    page.get_by_test_id("stop").click()
    page.wait_for_selector('[data-testid=stop-bar][data-stop="stopped"]')
    expect_live(page, seconds=10)
    camera.shoot("drive-stopped")
    page.get_by_test_id("release").hover()
    page.mouse.down()
    page.wait_for_timeout(1200)
    page.mouse.up()
    page.wait_for_selector('[data-testid=stop-bar][data-stop="none"]')


@contextmanager
def an_observer(demo: Demo) -> Iterator[str]:
    """A user who may watch sim1, until the pictures are taken; gives the password."""
    password = demo.robotether("user", "add", OBSERVER).split()[-1]
    try:
        demo.robotether("grant", OBSERVER, "sim1", "observe")
        yield password
    finally:
        demo.robotether("user", "remove", OBSERVER, "--yes")


def new_context(browser: Browser, size: str, scheme: str) -> BrowserContext:
    width, height = SIZES[size]
    return browser.new_context(
        ignore_https_errors=True,
        viewport={"width": width, "height": height},
        has_touch=size == "phone",
        color_scheme="dark" if scheme == "dark" else "light",
    )


def shoot_all(browser: Browser, demo: Demo, look: tuple[str, str], password: str) -> None:
    """Every page at one size and colour scheme; the observer has the password."""
    contexts = [new_context(browser, *look) for _ in range(2)]
    page, observer = (context.new_page() for context in contexts)
    camera = Camera(page, demo, "-".join(look))
    camera.open("/login")
    camera.shoot("login")
    log_in(page, demo)
    log_in(observer, demo, OBSERVER, password)
    shoot_driving(camera, demo, observer)
    for name, path in PAGES.items():
        camera.open(path)
        page.wait_for_timeout(1500)  # round trips arrive with the live feed
        camera.shoot(name, whole=True)
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
        with an_observer(demo) as password:
            for look in LOOKS:
                shoot_all(browser, demo, look, password)
        browser.close()
    keep_for_documents()
    sys.stdout.write(f"pictures are in {FOLDER.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()

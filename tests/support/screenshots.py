"""`make screenshots`: pictures of the pages over the running demo, at desktop and phone size, for people to see.

A machine that waits and a join token are made for the pictures, and removed again.
"""

from __future__ import annotations

import json
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from local_network import insecure_tls
from pages import Site, expect_live, log_in
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests" / "artifacts" / "screenshots"
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}
# Of the range that is kept for documentation: no machine has it.
STRANGERS_MAC, STRANGERS_NAME = "00:00:5e:00:53:01", "robot-005301"
STRANGERS_KEY = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAB"
ADMIN_PAGES = {
    "robots": "/admin/robots",
    "pending": "/admin/pending",
    "robot": "/admin/robots/sim1",
    "remove": "/admin/robots/sim1/remove",
    "users": "/admin/users",
    "user": "/admin/users/admin",
    "join-tokens": "/admin/join-tokens",
    "tokens": "/admin/tokens",
    "audit": "/admin/audit",
    "profile": "/profile",
    "unknown": "/robots/nobody",
}


@dataclass(frozen=True)
class Demo:
    """The running demo."""

    url: str
    admin_password: str


def compose(*arguments: str) -> str:
    """What tools/compose prints."""
    command = [str(ROOT / "tools" / "compose"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def running_demo() -> Demo:
    """The demo as tools/compose sees it."""
    password = ROOT / compose("--secrets-dir") / "admin_password"
    port = compose("--env", "HTTPS_PORT") or "443"
    return Demo(f"https://localhost:{port}", password.read_text())


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
        self.page.goto(f"{self.site.url}{path}")

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
    page.wait_for_function("document.querySelector('[data-testid=video]').naturalWidth > 0")
    drive_a_little(page)
    camera.shoot("drive")


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


def shoot_all(browser: Browser, site: Site, size: str, scheme: str) -> None:
    """Every page at one size and colour scheme."""
    width, height = SIZES[size]
    context = browser.new_context(
        ignore_https_errors=True,
        viewport={"width": width, "height": height},
        has_touch=size == "phone",
        color_scheme="dark" if scheme == "dark" else "light",
    )
    camera = Camera(context.new_page(), site, f"{size}-{scheme}")
    shoot_driving(camera)
    shoot_admin_pages(camera)
    context.close()


def main() -> None:
    """Take all pictures and say where they are."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    demo = running_demo()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium",
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        with a_stranger(demo, browser):
            for size in SIZES:
                for scheme in ("light", "dark"):
                    shoot_all(browser, demo, size, scheme)
        browser.close()
    sys.stdout.write(f"pictures are in {FOLDER.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()

"""`make screenshots`: pictures of the pages over the running demo, at desktop and phone size, for people to see."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests" / "artifacts" / "screenshots"
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}


def setting(name: str, default: str) -> str:
    """A setting of the demo as tools/compose sees it."""
    done = subprocess.run(
        [str(ROOT / "tools" / "compose"), "--env", name], capture_output=True, text=True, check=True
    )
    return done.stdout.strip() or default


def log_in(page: Page, server: str, password: str) -> None:
    """Log in as admin."""
    page.goto(f"{server}/login")
    page.get_by_test_id("login-name").fill("admin")
    page.get_by_test_id("login-password").fill(password)
    page.get_by_test_id("login-submit").click()
    page.wait_for_url(f"{server}/")


def drive_a_little(page: Page) -> None:
    """Hold W and A for two seconds, so that the picture shows a robot that moves."""
    page.keyboard.down("w")
    page.keyboard.down("a")
    page.wait_for_timeout(2000)


def shoot(browser: Browser, server: str, password: str, name: str, scheme: str) -> None:
    """Login, fleet and drive page at one size and colour scheme."""
    width, height = SIZES[name]
    context = browser.new_context(
        ignore_https_errors=True,
        viewport={"width": width, "height": height},
        has_touch=name == "phone",
        color_scheme="dark" if scheme == "dark" else "light",
    )
    page = context.new_page()
    page.goto(f"{server}/login")
    page.screenshot(path=FOLDER / f"login-{name}-{scheme}.png")
    log_in(page, server, password)
    page.wait_for_selector('[data-testid=robot-card-sim1][data-online="true"]')
    page.wait_for_timeout(1500)  # round trips arrive with the live feed
    page.screenshot(path=FOLDER / f"fleet-{name}-{scheme}.png")
    page.goto(f"{server}/robots/sim1")
    page.wait_for_selector('[data-testid=state][data-state="live"]')
    page.wait_for_function("document.querySelector('[data-testid=video]').naturalWidth > 0")
    drive_a_little(page)
    page.screenshot(path=FOLDER / f"drive-{name}-{scheme}.png")
    page.goto(f"{server}/robots/nobody")
    page.screenshot(path=FOLDER / f"unknown-{name}-{scheme}.png")
    context.close()


def main() -> None:
    """Take all pictures and say where they are."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    server = f"https://localhost:{setting('HTTPS_PORT', '443')}"
    secrets = subprocess.run(
        [str(ROOT / "tools" / "compose"), "--secrets-dir"],
        capture_output=True,
        text=True,
        check=True,
    )
    password = (ROOT / secrets.stdout.strip() / "admin_password").read_text()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium",
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        for name in SIZES:
            for scheme in ("light", "dark"):
                shoot(browser, server, password, name, scheme)
        browser.close()
    sys.stdout.write(f"pictures are in {FOLDER.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()

"""How a test's operator moves between the pages in a real browser.

Chromium drops every request when a network interface of this machine comes or goes, and the engine adds and removes
some for each container that these tests stop and start. That is the test machine's doing: a page that Chromium itself
replaced by its error page for that reason is opened again, and for no other.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from playwright.sync_api import Browser, Error, Page, Playwright, Request, expect

# The second is Chromium's own error page, which loads anew by itself while the test asks for a page.
INTERFACES_CHANGED = ("ERR_NETWORK_CHANGED", "is interrupted by another navigation")
PATIENCE_S = 40


class Site(Protocol):
    """Where the pages are: a test's stack, or the demo."""

    @property
    def url(self) -> str:
        """The site's address, without a slash at the end."""

    @property
    def admin_password(self) -> str:
        """The password of the user admin."""


def chromium(playwright: Playwright) -> Browser:
    """Debian's Chromium, without a screen."""
    return playwright.chromium.launch(
        executable_path="/usr/bin/chromium",
        args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
    )


def through_interface_changes(page: Page, step: Callable[[], object]) -> None:
    """Take a step that goes from page to page; from its beginning again when Chromium dropped a request of it."""
    end = time.monotonic() + PATIENCE_S
    while _was_dropped(page, step):
        assert time.monotonic() < end, (
            f"this machine's interfaces change for {PATIENCE_S} s already"
        )


def _was_dropped(page: Page, step: Callable[[], object]) -> bool:
    try:
        step()
    except (Error, AssertionError) as error:
        is_chromiums = any(words in str(error) for words in INTERFACES_CHANGED)
        if is_chromiums or page.url.startswith("chrome-error://"):
            return True
        raise
    return False


def log_in(page: Page, site: Site, name: str = "admin", password: str | None = None) -> None:
    """Log in through the form as a person does, and arrive at the fleet page."""

    def step() -> None:
        page.goto(f"{site.url}/login")
        page.get_by_test_id("login-name").fill(name)
        page.get_by_test_id("login-password").fill(password or site.admin_password)
        page.get_by_test_id("login-submit").click()
        page.wait_for_url(f"{site.url}/", timeout=10_000)

    through_interface_changes(page, step)


def open_robot(page: Page, site: Site, name: str) -> None:
    """Go from the fleet page to a robot's page and wait until it can be driven."""

    def step() -> None:
        if page.url != f"{site.url}/":
            page.goto(f"{site.url}/")
        page.get_by_test_id(f"robot-card-{name}").get_by_role("link").first.click()
        page.wait_for_url(f"**/robots/{name}", timeout=10_000)

    through_interface_changes(page, step)
    expect_live(page, seconds=10)


def open_live(page: Page, site: Site, robot: str) -> None:
    """Go straight to a robot's page and wait until its connection stands, also if Chromium drops the page's script."""
    dropped: list[str] = []

    def note(request: Request) -> None:
        dropped.append(f"{request.url}: {request.failure}")

    def step() -> None:
        dropped.clear()
        page.goto(f"{site.url}/robots/{robot}")
        try:
            expect_live(page, seconds=15)
        except AssertionError as error:
            raise AssertionError(f"{error}\nrequests that failed: {dropped}") from error

    page.on("requestfailed", note)
    try:
        through_interface_changes(page, step)
    finally:
        page.remove_listener("requestfailed", note)


def expect_live(page: Page, seconds: float) -> None:
    """Wait until the page says that the robot can be driven."""
    state = page.get_by_test_id("state")
    expect(state).to_have_attribute("data-state", "live", timeout=seconds * 1000)


def open_page(page: Page, site: Site, path: str) -> None:
    """Go straight to a page that needs no waiting."""
    through_interface_changes(page, lambda: page.goto(f"{site.url}{path}"))


def expect_no_sideways_scroll(page: Page) -> None:
    """Fail when the page is wider than the screen, and say what is."""
    wide = page.evaluate(
        "document.documentElement.scrollWidth <= innerWidth ? [] : "
        "[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > innerWidth)"
        ".map(e => e.outerHTML.slice(0, 80))"
    )
    assert wide == [], f"{page.url} is too wide: {wide[:3]}"

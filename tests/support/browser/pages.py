"""How a test's operator moves between the pages in a real browser."""

from __future__ import annotations

import atexit
import functools
import os
import re
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any, Protocol

import namespaces
from playwright.sync_api import (
    APIRequestContext,
    Browser,
    BrowserContext,
    Page,
    Playwright,
    expect,
)

LAUNCHER = Path(__file__).with_name("chromium_in_namespace")


@dataclass(frozen=True)
class BrowserNetwork:
    """A namespace of the tests' browser, made once a process, and this machine's address as seen from there.

    Chromium drops every request that is under way when an interface of its network comes or goes, and the Docker
    engine adds and removes some for each container. A server that a page is to reach must listen on 0.0.0.0.
    """

    name: str
    machine: str

    @property
    def arguments(self) -> list[str]:
        """What Chromium is told, so that pages of this machine have the names that they have outside."""
        rules = ", ".join(f"MAP {name} {self.machine}" for name in ("localhost", "127.0.0.1"))
        return [f"--host-resolver-rules={rules}"]

    @property
    def environment(self) -> dict[str, str | float | bool]:
        return {**os.environ, "BROWSER_NAMESPACE": self.name}


@functools.cache
def browser_network() -> BrowserNetwork:
    namespaces.sweep()
    made = ExitStack()
    atexit.register(made.close)
    # This machine has other addresses too, as that at which the demo is asked.
    inside, machine = namespaces.make_joined(made, "browser")
    return BrowserNetwork(inside.name, machine)


CSRF = re.compile(r'name="csrf_token" value="([^"]+)"')
ARGUMENTS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")
# In one look: a page that is held may lose its connection before the next one.
LIVE = "[data-testid=state][data-state=live]:not([data-shown=held])"
# A page puts its parts into place in the frame after its size has changed, as of matchMedia and ResizeObserver.
NEXT_FRAMES = (
    "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
)
# Of each site, name and password.
_cookies: dict[tuple[str, str, str], list[Any]] = {}


class Site(Protocol):
    @property
    def url(self) -> str:
        pass

    @property
    def admin_password(self) -> str: ...


def chromium(playwright: Playwright) -> Browser:
    """Debian's Chromium, without a screen, in a network of its own."""
    network = browser_network()
    return playwright.chromium.launch(
        executable_path=LAUNCHER,
        args=[*ARGUMENTS, *network.arguments],
        env=network.environment,
    )


def log_in(page: Page, site: Site, name: str = "admin", password: str | None = None) -> None:
    page.goto(f"{site.url}/login")
    page.get_by_test_id("login-name").fill(name)
    page.get_by_test_id("login-password").fill(password or site.admin_password)
    page.get_by_test_id("login-submit").click()
    page.wait_for_url(f"{site.url}/", timeout=10_000)


def be_logged_in(
    context: BrowserContext, site: Site, name: str = "admin", password: str | None = None
) -> None:
    """Give a browser the cookies of this person, who logs in beside it once; a page that logs out uses `log_in`."""
    secret = password or site.admin_password
    key = (site.url, name, secret)
    if key not in _cookies:
        _cookies[key] = _cookies_of(context.request, site, name, secret)
    context.add_cookies(_cookies[key])


def forget_login(site: Site, name: str) -> None:
    """Let this person log in anew: a user who is made again is another, for whom an older login does not count."""
    for key in [key for key in _cookies if key[:2] == (site.url, name)]:
        del _cookies[key]


def _cookies_of(http: APIRequestContext, site: Site, name: str, password: str) -> list[Any]:
    door = f"{site.url}/login"
    form = CSRF.search(http.get(door).text())
    assert form is not None, f"{door} has no form"
    answer = http.post(
        door,
        form={"csrf_token": form[1], "name": name, "password": password, "next": ""},
        headers={"Referer": door},
        max_redirects=0,
    )
    assert answer.status == HTTPStatus.SEE_OTHER, answer.text()
    return list(http.storage_state()["cookies"])


def open_robot(page: Page, site: Site, name: str) -> None:
    """Go from the fleet page to a robot's page, which watches, and wait until its connection stands."""
    if page.url != f"{site.url}/":
        page.goto(f"{site.url}/")
    page.get_by_test_id(f"robot-card-{name}").get_by_role("link").first.click()
    page.wait_for_url(f"**/robots/{name}", timeout=10_000)
    expect_live(page, seconds=10)


def open_live(page: Page, site: Site, robot: str) -> None:
    page.goto(f"{site.url}/robots/{robot}")
    expect_live(page, seconds=15)


def drive_live(page: Page, site: Site, robot: str) -> None:
    open_live(page, site, robot)
    take_control(page)


def take_control(page: Page) -> None:
    page.get_by_test_id("control-drive").click()
    expect_mode(page, "drive")


def answer(page: Page, test_id: str) -> None:
    """Press a button of a question, as soon as that hears."""
    page.locator(f"[data-deaf=false] [data-testid={test_id}]").click()


def open_drawer(page: Page) -> None:
    """Open what is rarely needed on the drive page, if it is not open."""
    if not page.get_by_test_id("drawer").is_visible():
        page.get_by_test_id("drawer-open").click()


def expect_mode(page: Page, mode: str) -> None:
    """Wait until the page drives or watches, with a connection that stands."""
    # In one look: the connection may be that of the mode before, and the mode that of the connection to come.
    control = f"[data-testid=control][data-mode={mode}]"
    stands = page.locator(f"body:has({control}):has({LIVE})")
    expect(stands).to_have_count(1, timeout=10_000)


def expect_live(page: Page, seconds: float) -> None:
    """Wait until the page's connection stands, and whoever drives sees a picture to drive by."""
    expect(page.locator(LIVE)).to_have_count(1, timeout=seconds * 1000)


def expect_small_map(page: Page) -> None:
    """Wait until the drive page shows the map beside its stick, and where the robot is: it comes last."""
    expect(page.get_by_test_id("small-map")).to_be_visible(timeout=15_000)
    expect(page.get_by_test_id("small-map-pose")).not_to_be_empty()


def resize(page: Page, width: int, height: int) -> None:
    page.set_viewport_size({"width": width, "height": height})
    page.evaluate(NEXT_FRAMES)


def hide(page: Page) -> None:
    page.evaluate(
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
        "document.dispatchEvent(new Event('visibilitychange'))"
    )


def expect_armed(page: Page) -> None:
    expect(page.get_by_test_id("joystick")).to_have_attribute("data-armed", "true")


def wait_until(page: Page, what: str, condition: Callable[[], bool], seconds: float = 10) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"after {seconds} s still not {what}"
        page.wait_for_timeout(50)


def open_page(page: Page, site: Site, path: str) -> None:
    page.goto(f"{site.url}{path}")


def expect_no_sideways_scroll(page: Page) -> None:
    wide = page.evaluate(
        "document.documentElement.scrollWidth <= innerWidth ? [] : "
        "[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > innerWidth)"
        ".map(e => e.outerHTML.slice(0, 80))"
    )
    assert wide == [], f"{page.url} is too wide for {page.viewport_size}: {wide[:3]}"

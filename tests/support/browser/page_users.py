"""The people of an end-to-end test: users with a grant for one robot, each in a browser of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from pages import be_logged_in, forget_login, open_live, take_control
from playwright.sync_api import Browser, BrowserContext, Page, ViewportSize
from stack import Stack

PASSWORD = "a long enough password"
DESKTOP: ViewportSize = {"width": 1280, "height": 800}


class PageUsers:
    def __init__(self, stack: Stack, browser: Browser) -> None:
        self.stack = stack
        self._browser = browser
        self._open = ExitStack()

    def let(self, name: str, level: str, robot: str) -> None:
        """Give a user, made now if there is none of that name, a level on a robot."""
        admin = self.stack.admin
        if name not in admin.users():
            admin.add_user(name, PASSWORD)
            forget_login(self.stack, name)
        if admin.grant(name, robot, level):
            self.stack.wait_for_right(name, robot)

    def open_fleet(self, name: str) -> Page:
        page = self.browse(name)
        page.goto(f"{self.stack.url}/")
        return page

    def browse(self, name: str) -> Page:
        context = self._open.enter_context(self._context())
        be_logged_in(context, self.stack, name, None if name == "admin" else PASSWORD)
        return context.new_page()

    def open(self, name: str, robot: str) -> Page:
        page = self.browse(name)
        self.go(page, robot)
        return page

    def drive(self, name: str, robot: str) -> Page:
        page = self.open(name, robot)
        take_control(page)
        return page

    def go(self, page: Page, robot: str) -> None:
        open_live(page, self.stack, robot)

    def close(self) -> None:
        self._open.close()
        self._open = ExitStack()

    @contextmanager
    def _context(self) -> Iterator[BrowserContext]:
        context = self._browser.new_context(ignore_https_errors=True, viewport=DESKTOP)
        try:
            yield context
        finally:
            context.close()


def release_all(stack: Stack, robots: list[str]) -> None:
    def released(robot: str) -> Callable[[], bool]:
        return lambda: stack.admin.try_to("POST", f"/robots/{robot}/release", {})[0] == 200

    for robot in robots:
        stack.wait(f"{robot} released", released(robot), "relay", robot)

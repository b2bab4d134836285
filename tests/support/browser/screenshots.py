"""`make screenshots`: the documents' pictures of the running demo, into docs/screenshots.

They show the drive page, and an alert's mail, for which the demo needs the profile metrics. An observer is made for the
pictures and removed again; sim1's cameras freeze, it is stopped and released.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from alert_mail import alert_mail, as_page
from demo import ROOT, Demo
from pages import chromium, expect_live, log_in, open_page, take_control
from PIL import Image
from playwright.sync_api import Browser, FloatRect, Page, sync_playwright
from sim_service import frozen_cameras

FOLDER = ROOT / "docs" / "screenshots"
WIDTH, HEIGHT = 1280, 800
# What the page "Driving" shows of a state: where it stands.
TOP = FloatRect(x=0, y=0, width=WIDTH, height=150)
MAIL = FloatRect(x=0, y=0, width=WIDTH, height=480)
# The pictures are kept in the repository. A camera has more colours than the pages, whose few must stay.
COLOURS = 256
OBSERVER = "olga-of-pictures"


def shoot(page: Page, name: str, clip: FloatRect | None = None) -> None:
    path = FOLDER / f"{name}.png"
    page.screenshot(path=path, clip=clip)
    picture = Image.open(path).convert("RGB")
    picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


def shoot_driving(page: Page, demo: Demo, observer: Page) -> None:
    open_page(page, demo, "/robots/sim1")
    expect_live(page, seconds=30)
    take_control(page)
    page.wait_for_selector('[data-testid=joystick][data-armed="true"]')
    page.keyboard.down("w")
    page.keyboard.down("a")
    page.wait_for_timeout(2000)  # for a robot that moves
    shoot(page, "drive-desktop-light")
    page.keyboard.up("w")
    page.keyboard.up("a")
    open_page(observer, demo, "/robots/sim1")
    expect_live(observer, seconds=30)
    observer.wait_for_timeout(1000)  # for a picture
    shoot(observer, "drive-observing", TOP)
    with frozen_cameras(demo, "sim1"):
        page.wait_for_selector('[data-testid=state][data-shown="held"]')
        shoot(page, "drive-held", TOP)
    page.wait_for_selector('[data-testid=joystick][data-armed="true"]')
    page.get_by_test_id("stop").click()
    page.wait_for_selector('[data-testid=stop-bar][data-stop="stopped"]')
    expect_live(page, seconds=10)
    shoot(page, "drive-stopped", TOP)
    page.get_by_test_id("release").hover()
    page.mouse.down()
    page.wait_for_selector('[data-testid=stop-bar][data-stop="none"]')
    page.mouse.up()


def shoot_alert_mail(page: Page, demo: Demo) -> None:
    page.set_content(as_page(alert_mail(demo)))
    shoot(page, "alert-mail", MAIL)


@contextmanager
def an_observer(demo: Demo) -> Iterator[str]:
    password = demo.robotether("user", "add", OBSERVER).split()[-1]
    try:
        demo.robotether("grant", OBSERVER, "sim1", "observe")
        yield password
    finally:
        demo.robotether("user", "remove", OBSERVER, "--yes")


def new_page(browser: Browser) -> Page:
    return browser.new_context(
        ignore_https_errors=True,
        viewport={"width": WIDTH, "height": HEIGHT},
        color_scheme="light",
    ).new_page()


def main() -> None:
    demo = Demo()
    with sync_playwright() as playwright, an_observer(demo) as password:
        browser = chromium(playwright)
        page, observer = new_page(browser), new_page(browser)
        log_in(page, demo)
        log_in(observer, demo, OBSERVER, password)
        shoot_driving(page, demo, observer)
        shoot_alert_mail(new_page(browser), demo)
        browser.close()


if __name__ == "__main__":
    main()

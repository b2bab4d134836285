"""`make screenshots`: the documents' pictures of the running demo, into docs/screenshots.

They show the drive page, and an alert's mail, for which the demo needs the profile metrics. An observer is made for the
pictures and removed again; sim1's cameras freeze, it is stopped and released.
"""

from __future__ import annotations

import html
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from email import message_from_bytes
from email.message import EmailMessage
from email.policy import default
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Thread

from demo import ROOT, Demo
from pages import chromium, expect_live, log_in, open_page, take_control
from PIL import Image
from playwright.sync_api import Browser, FloatRect, Page, sync_playwright
from sim_service import frozen_cameras

START_WITHIN_S, SENT_WITHIN_S = 30, 60
ALERTMANAGER_URL = "--alertmanager.url=http://127.0.0.1:9093"
# As images/prometheus/rules.yml has it.
ALERT = (
    "alertname=CellDown",
    "instance=relay:9100",
    "job=robotether",
    "--annotation=summary=relay:9100 does not answer",
    "--annotation=what_to_do=docs/howto/metrics.md#celldown",
)


@contextmanager
def mail_server(address: str) -> Iterator[tuple[int, queue.Queue[bytes]]]:
    mails: queue.Queue[bytes] = queue.Queue()

    class MailHandler(StreamRequestHandler):
        def handle(self) -> None:
            self.wfile.write(b"220 mail.lab.example\r\n")
            for line in self.rfile:
                command = line.strip().upper()
                if command == b"DATA":
                    self.wfile.write(b"354 go on\r\n")
                    mails.put(b"".join(iter(self.rfile.readline, b".\r\n")))
                self.wfile.write(b"221 bye\r\n" if command == b"QUIT" else b"250 done\r\n")
                if command == b"QUIT":
                    return

    with ThreadingTCPServer((address, 0), MailHandler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_address[1], mails
        finally:
            server.shutdown()


def alert_mail(demo: Demo) -> EmailMessage:
    with mail_server(demo.machine) as (port, mails):
        container = demo.engine.containers.run(
            str(demo.container("alertmanager").attrs["Image"]),
            entrypoint="/usr/lib/robotether/alertmanager",
            environment={
                "ALERT_EMAIL_TO": "ann@lab.example",
                "ALERT_EMAIL_FROM": "robots@lab.example",
                "ALERT_SMTP": f"{demo.machine}:{port}",
                "ALERT_SMTP_TLS": "no",
            },
            tmpfs={"/run/alertmanager": "uid=33,gid=33,mode=0700"},
            detach=True,
        )
        try:
            wait = f"timeout {START_WITHIN_S} sh -c 'until /usr/lib/robotether/healthy 9093; do sleep 0.2; done'"
            container.exec_run(["sh", "-c", wait])
            status, said = container.exec_run(["amtool", ALERTMANAGER_URL, "alert", "add", *ALERT])
            if status:
                raise RuntimeError(f"cannot add an alert: {said!r}")
            mail = mails.get(timeout=SENT_WITHIN_S)
        finally:
            container.remove(force=True, v=True)
    return message_from_bytes(mail, policy=default)


def as_page(mail: EmailMessage) -> str:
    heads = "".join(
        f"<div><b>{name}:</b> {html.escape(str(mail[name]))}</div>"
        for name in ("From", "To", "Subject")
    )
    body = mail.get_body(("html",))
    return f"<div style='font: 15px sans-serif; padding: 12px'>{heads}</div>{body and body.get_content()}"


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

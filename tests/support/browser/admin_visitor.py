"""What tests of the admin pages do again and again: machines that ask to join, forms that are sent."""

from __future__ import annotations

from robot_signer import RobotSigner
from web_visitor import Browser
from werkzeug.test import TestResponse


def public_key(number: int) -> str:
    return RobotSigner(number).line


def fingerprint(number: int) -> str:
    return RobotSigner(number).key.fingerprint


def join(
    program: Browser, mac: str, key: int, hostname: str = "turtle", **more: str
) -> TestResponse:
    body = RobotSigner(key).join(mac, hostname=hostname, **more)
    return program.ask("POST", "/api/v1/join", json=body)


def send(browser: Browser, path: str, **form: str) -> TestResponse:
    """Send a form with the token of the visitor's pages."""
    browser.form_token = browser.form_token or browser.csrf_of("/")
    return browser.ask("POST", path, data={"csrf_token": browser.form_token, **form})

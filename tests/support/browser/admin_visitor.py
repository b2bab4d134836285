"""What tests of the admin pages do again and again: machines that ask to join, forms that are sent."""

from __future__ import annotations

import base64
import struct

from robotether_server import identity
from web_visitor import Browser
from werkzeug.test import TestResponse


def public_key(number: int) -> str:
    """A public key line that is like no other number's."""
    fields = (b"ssh-ed25519", number.to_bytes(32, "big"))
    blob = b"".join(struct.pack(">I", len(field)) + field for field in fields)
    return f"ssh-ed25519 {base64.b64encode(blob).decode()} comment"


def fingerprint(number: int) -> str:
    """The fingerprint of that key, as OpenSSH prints it."""
    return identity.parse_robots_key(public_key(number)).fingerprint


def join(
    program: Browser, mac: str, key: int, hostname: str = "turtle", **more: str
) -> TestResponse:
    """A machine asks to be let in."""
    body = {
        "mac": mac,
        "public_key": public_key(key),
        "hostname": hostname,
        "agent_version": "0.1.0",
        **more,
    }
    return program.ask("POST", "/api/v1/join", json=body)


def send(browser: Browser, path: str, **form: str) -> TestResponse:
    """Send a form with the token of the page that it stands on."""
    return browser.ask("POST", path, data={"csrf_token": browser.csrf_of("/"), **form})

"""What is looked at before a robot is changed: its server through an HTTP proxy, on a network that has no other way."""

from __future__ import annotations

import asyncio
import hashlib
import ssl
from pathlib import Path
from typing import Any

import pytest
from ansible_module import run_module
from fake_proxy import PASSWORD, USER, FakeProxy


async def problems_of(arguments: dict[str, Any]) -> list[str]:
    """Run the module once on this machine, and return what it found."""
    result = await run_module("preflight", {"folders": ["/"], "free_mb": 0, **arguments})
    found: list[str] = result["problems"]
    return found


@pytest.fixture
def pin(certificate: Path) -> str:
    """The certificate's SHA-256."""
    pem = certificate.read_text().partition("-----BEGIN PRIVATE KEY")[0]
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(pem)).hexdigest()


async def test_server_is_reached_through_the_robots_proxy(certificate: Path, pin: str) -> None:
    """With the proxy's password, and with the pin; a wrong password is named as the proxy's refusal."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    server = await asyncio.start_server(
        lambda _, writer: writer.close(), "127.0.0.1", 0, ssl=context
    )
    port = server.sockets[0].getsockname()[1]
    asked = {"server": f"localhost:{port}", "tls_fingerprint": pin}
    async with server, FakeProxy("needs_password") as proxy:
        login = f"{USER}:{PASSWORD.replace('/', '%2F').replace('@', '%40').replace(':', '%3A')}"
        with_login = proxy.url.replace("//", f"//{login}@")
        assert await problems_of({**asked, "http_proxy": with_login}) == []
        (problem,) = await problems_of({**asked, "http_proxy": proxy.url})
    assert proxy.asked == [f"localhost:{port}"] * 2
    assert "Tunnel connection failed: 407" in problem
    assert "check its network, robotether_agent_http_proxy" in problem


async def test_room_is_needed_in_each_folder() -> None:
    """Docker may keep its images on another file system than the agent's own folder."""
    folders = ["/", "/proc/self"]
    (full, *_) = await problems_of({"server": "127.0.0.1:1", "folders": folders, "free_mb": 1})
    assert "/proc/self has 0 MB free and the agent needs 1 MB" in full

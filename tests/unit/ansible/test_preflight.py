"""What is looked at before a robot is changed: its server through an HTTP proxy, on a network that has no other way."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import ssl
import sys
from pathlib import Path
from typing import Any

import pytest
from fake_proxy import PASSWORD, USER, FakeProxy

ANSIBLE = Path(__file__).resolve().parents[3] / "ansible"
WAIT_S = 60


async def problems_of(arguments: dict[str, Any]) -> list[str]:
    """Run the module once on this machine, and return what it found."""
    process = await asyncio.create_subprocess_exec(
        Path(sys.executable).with_name("ansible"), "localhost", "--inventory", "localhost,",
        "--connection", "local", "--extra-vars", f"ansible_python_interpreter={sys.executable}",
        "--playbook-dir", str(ANSIBLE), "--module-name", "robotether.robotether.preflight",
        "--args", json.dumps({"folder": "/", "free_mb": 0, **arguments}),
        env={**os.environ, "ANSIBLE_NOCOLOR": "1"},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    printed, errors = await asyncio.wait_for(process.communicate(), WAIT_S)
    _, arrow, result = printed.decode().partition("=> ")
    assert arrow, f"{printed.decode()}\n{errors.decode()}"
    found: list[str] = json.loads(result)["problems"]
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

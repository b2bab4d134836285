"""What agent/join.sh gets from the server on a network that lets nothing out but an HTTP proxy."""

import asyncio
import os
import subprocess
from pathlib import Path

import pytest
import tls_web
from fake_cloud import certificate, fingerprint
from fake_proxy import PASSWORD, USER, FakeProxy

SCRIPT = Path(__file__).resolve().parents[3] / "agent/join.sh"


@pytest.fixture
def server():
    """A server that has one file."""

    def manifest(_environ, respond):
        respond("200 OK", [])
        return [b"all of it"]

    with tls_web.running(manifest, certificate=certificate()) as web:
        yield web.address.replace("127.0.0.1", "localhost")


async def fetch(server, place, *options, **environ):
    """Let the script get the file, and return that, or its error."""
    (place / "steps.sh").write_text(SCRIPT.read_text().removesuffix('main "$@"\n'))
    step = f'set -eu; . {place}/steps.sh; CONFIG={place}/none; read_options "$@"; get /agent/manifest {place}/file'
    options = ("--server", server, "--tls-fingerprint", fingerprint(), *options)
    done = await asyncio.to_thread(
        subprocess.run,
        ["sh", "-c", step, "join.sh", *options],
        env={**os.environ, "no_proxy": "localhost", **environ},
        capture_output=True,
        text=True,
        timeout=20,
    )
    return (place / "file").read_text() if done.returncode == 0 else done.stderr


@pytest.mark.parametrize("way", ["option", "environment"])
async def test_server_is_asked_through_the_proxy(server, tmp_path, way):
    """The agent's own proxy needs no other word; else https_proxy counts, as it does for curl."""
    async with FakeProxy() as proxy:
        if way == "option":
            got = await fetch(server, tmp_path, "--http-proxy", proxy.url)
        else:
            got = await fetch(server, tmp_path, https_proxy=proxy.url, no_proxy="")
        assert got == "all of it"
        assert proxy.asked == [server]


async def test_proxy_gets_its_password(server, tmp_path):
    login = f"{USER}:{PASSWORD.replace('/', '%2F').replace('@', '%40').replace(':', '%3A')}"
    async with FakeProxy("needs_password") as proxy:
        url = proxy.url.replace("//", f"//{login}@")
        assert await fetch(server, tmp_path, "--http-proxy", url) == "all of it"
        refused = await fetch(server, tmp_path, "--http-proxy", proxy.url)
    assert "Tunnel connection failed: 407" in refused

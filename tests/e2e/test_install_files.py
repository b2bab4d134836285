"""What the image serves to a robot that installs itself, through nginx, and the line that starts it."""

from __future__ import annotations

import hashlib
import io
import shlex
import subprocess
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from local_network import insecure_tls
from stack import ROOT, Stack


def fetch(stack: Stack, path: str) -> bytes:
    with urllib.request.urlopen(stack.url + path, timeout=10, context=insecure_tls()) as answer:
        return bytes(answer.read())


@pytest.fixture
def invitation(stack: Stack) -> Iterator[dict[str, Any]]:
    """A join token with its line, deleted afterwards."""
    headers = {"Authorization": f"Bearer {stack.token('invite')}"}
    body = {"name": "install files", "uses": 1, "hours": 1}
    status, made = stack.request("POST", "/api/v1/join-tokens", body, headers)
    assert status == 201, made
    yield made
    stack.request("DELETE", f"/api/v1/join-tokens/{made['id']}", headers=headers)
    tokens = stack.request("GET", "/api/v1/tokens", headers=headers)[1]["tokens"]
    [own] = [item["id"] for item in tokens if item["name"] == "invite"]
    stack.request("DELETE", f"/api/v1/tokens/{own}", headers=headers)


def test_script_is_the_one_of_this_checkout(stack: Stack) -> None:
    assert fetch(stack, "/join.sh") == (ROOT / "agent" / "join.sh").read_bytes()


def test_manifest_lists_the_agents_wheel_and_its_dependencies(stack: Stack) -> None:
    """The manifest has the hashes of the served files."""
    lines = fetch(stack, "/agent/manifest").decode().splitlines()
    files = {name: fetch(stack, f"/agent/{name}") for _, name in (line.split() for line in lines)}
    assert [f"{hashlib.sha256(data).hexdigest()}  {name}" for name, data in files.items()] == lines
    assert files.pop("requirements.txt") == (ROOT / "agent" / "requirements.txt").read_bytes()
    [(name, wheel)] = files.items()
    assert name.startswith("robotether_agent-")
    with zipfile.ZipFile(io.BytesIO(wheel)) as packed:
        assert "robotether_agent/__main__.py" in packed.namelist()


@pytest.mark.parametrize(("architecture", "machine"), [("amd64", "x86_64"), ("arm64", "aarch64")])
def test_package_has_the_same_agent_and_the_wheels_of_each_python(
    stack: Stack, tmp_path: Path, architecture: str, machine: str
) -> None:
    """So that the install line, run after it, has nothing to fetch; tests/ansible/test_agent_deb.py installs it."""
    package = tmp_path / "agent.deb"
    package.write_bytes(fetch(stack, f"/agent.deb?arch={architecture}"))
    printed = subprocess.run(
        ["dpkg-deb", "--field", package, "Architecture"], check=True, capture_output=True, text=True
    )
    assert printed.stdout.strip() == architecture
    subprocess.run(["dpkg-deb", "--extract", package, tmp_path], check=True)
    files = tmp_path / "usr" / "share" / "robotether-agent"
    assert (files / "manifest").read_bytes() == fetch(stack, "/agent/manifest")
    for version in ("cp310", "cp311", "cp312", "cp313"):
        assert list(files.glob(f"aiohttp-*-{version}-*{machine}*.whl")), version


def test_line_pins_the_certificate_that_nginx_shows(
    stack: Stack, invitation: dict[str, Any]
) -> None:
    """Self-signed here, so the line has its fingerprint, and the port that was asked."""
    printed = stack.exec(
        "nginx",
        *shlex.split("openssl x509 -in /run/nginx/tls/cert.pem -noout -fingerprint -sha256"),
    )
    fingerprint = printed.strip().split("=")[1].replace(":", "").lower()
    words = shlex.split(invitation["command"])
    assert words[words.index("--tls-fingerprint") + 1] == fingerprint
    assert words[words.index("--server") + 1] == f"localhost:{stack.https_port}"
    assert words[words.index("--token") + 1] == invitation["token"]

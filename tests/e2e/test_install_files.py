"""What the image serves to a robot that installs itself, through nginx."""

import subprocess
import urllib.request

import pytest
from local_network import insecure_tls


def fetch(stack, path):
    with urllib.request.urlopen(stack.url + path, timeout=10, context=insecure_tls()) as answer:
        return bytes(answer.read())


@pytest.mark.parametrize(("architecture", "machine"), [("amd64", "x86_64"), ("arm64", "aarch64")])
def test_package_has_the_same_agent_and_the_wheels_of_each_python(
    stack, tmp_path, architecture, machine
):
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

"""What is looked at before a robot is changed: its server through an HTTP proxy, on a network that has no other way."""

import ast
import asyncio
import hashlib
import re
import ssl

import pytest
from ansible_module import ANSIBLE, of_role, play, run_module
from commands import write_programs
from fake_proxy import PASSWORD, USER, FakeProxy

pytestmark = pytest.mark.release


async def problems_of(arguments):
    """Run the module once on this machine, and return what it found."""
    result = await run_module("preflight", {"folders": ["/"], "free_mb": 0, **arguments})
    return result["problems"]


@pytest.fixture
def pin(certificate):
    """The certificate's SHA-256."""
    pem = certificate.read_text().partition("-----BEGIN PRIVATE KEY")[0]
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(pem)).hexdigest()


async def test_server_is_reached_through_the_robots_proxy(certificate, pin):
    """It takes the proxy's password, and the pin; a wrong password is named as the proxy's refusal."""
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


async def test_room_is_needed_in_each_folder():
    """Docker may keep its images on another file system than the agent's own folder."""
    folders = ["/", "/proc/self"]
    (full, *_) = await problems_of({"server": "127.0.0.1:1", "folders": folders, "free_mb": 1})
    assert "/proc/self has 0 MB free and the agent needs 1 MB" in full


@pytest.mark.parametrize("name", ["modules/preflight.py", "module_utils/server.py"])
def test_robots_python_reads_the_module(name):
    """Where the agent runs in a container, Ubuntu 20.04 will do."""
    ast.parse((ANSIBLE / "plugins" / name).read_text(), feature_version=(3, 8))


@pytest.mark.parametrize(
    ("python", "runtime", "oldest"),
    [
        ("3.9.2", "venv", "3.10, or 3.8 with agent_runtime docker"),
        ("3.10.0", "venv", None),
        ("3.7.3", "docker", "3.8"),
        ("3.8.10", "docker", None),
    ],
)
def test_older_python_is_refused(tmp_path, python, runtime, oldest):
    """Before a module runs, of which it would print a syntax error; in a container the agent has its own."""
    write_programs(tmp_path, {"python3": f"echo {python}", "docker": "echo"})
    # No server is set, so nothing is looked at after the assertions.
    role = of_role("robotether_agent", "preflight")
    played = play(tmp_path, [role], agent_runtime=runtime).stdout
    assert "robotether_agent_server is not set" in played
    refused = re.findall(r"cannot enrol localhost: its Python is (.*?); upgrade", played)
    assert set(refused) == ({f"{python} and the agent needs {oldest}"} if oldest else set())

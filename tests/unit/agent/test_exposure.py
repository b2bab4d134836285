"""Whom the robot's services answer beyond the robot itself, and the advice that confines them."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import namespaces
import pytest
from local_network import free_port
from robotether_agent.exposure import ADDRESS_ADVICE, FIREWALL_ADVICE, exposed_at, rosbridge_advice
from tcp_service import TcpService

FIREWALL = Path(__file__).resolve().parents[3] / "ros" / "robotether-ros.nft"
ROSBRIDGE_PORT = 9090

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="a network namespace needs root")


@pytest.fixture
def network() -> Iterator[None]:
    with ExitStack() as made, namespaces.make(made, "exposure").entered():
        yield


@needs_root
@pytest.mark.usefixtures("network")
@pytest.mark.parametrize(
    ("family", "address", "expected"),
    [
        (socket.AF_INET, "0.0.0.0", "0.0.0.0"),
        (socket.AF_INET, "127.0.0.1", ""),
        (socket.AF_INET, "127.0.1.1", ""),
        (socket.AF_INET6, "::", "::"),
        (socket.AF_INET6, "::1", ""),
        (socket.AF_INET6, "::ffff:127.0.0.1", ""),
    ],
)
def test_only_an_address_beyond_loopback_is_told(family, address, expected):
    is_ipv6 = family == socket.AF_INET6
    with socket.create_server((address, 0), family=family, dualstack_ipv6=is_ipv6) as listening:
        url = f"ws://127.0.0.1:{listening.getsockname()[1]}/"
        assert exposed_at(url) == expected
    assert exposed_at(url) == ""


@needs_root
@pytest.mark.usefixtures("network")
def test_connections_are_no_listeners():
    """A robot's program that talks to its own rosbridge, or to another one at the same port, exposes nothing."""
    with (
        socket.create_server(("127.0.0.1", 0)) as listening,
        socket.create_connection(listening.getsockname()) as client,
    ):
        assert exposed_at(f"ws://127.0.0.1:{client.getsockname()[1]}") == ""


@needs_root
@pytest.mark.usefixtures("network")
def test_firewall_of_ros_1_closes_the_port_to_all_but_this_machine():
    """Rosbridge still listens on all interfaces; only what really answers counts."""
    namespaces.ip("link", "add", "robot", "type", "veth", "peer", "name", "others")
    namespaces.ip("address", "add", "192.0.2.1/24", "dev", "robot")
    namespaces.ip("link", "set", "robot", "up")
    url = f"ws://127.0.0.1:{ROSBRIDGE_PORT}/"
    with socket.create_server(("0.0.0.0", ROSBRIDGE_PORT)):
        assert exposed_at(url) == "192.0.2.1"
        # Twice, as at each start of the unit.
        for _ in range(2):
            subprocess.run(["nft", "-f", str(FIREWALL)], check=True)
        assert exposed_at(url) == ""
        socket.create_connection(("127.0.0.1", ROSBRIDGE_PORT), timeout=5).close()


@needs_root
@pytest.mark.usefixtures("network")
def test_a_port_that_answers_over_ipv6_alone_is_told():
    """A firewall may close it only over IPv4."""
    namespaces.ip("link", "add", "robot", "type", "veth", "peer", "name", "others")
    namespaces.ip("link", "set", "robot", "addrgenmode", "none")
    namespaces.ip("address", "add", "192.0.2.1/24", "dev", "robot")
    namespaces.ip("address", "add", "2001:db8::1/64", "dev", "robot", "nodad")
    namespaces.ip("link", "set", "robot", "up")
    with socket.create_server(("::", 0), family=socket.AF_INET6) as rosbridge:
        url = f"ws://127.0.0.1:{rosbridge.getsockname()[1]}/"
        assert exposed_at(url) == "2001:db8::1"


class NamedServer(TcpService):
    def __init__(self, server: str) -> None:
        super().__init__()
        self._server_name = server

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        lines = ("HTTP/1.1 101 Switching Protocols", f"Server: {self._server_name}")
        lines += ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Accept: x", "", "")
        writer.write("\r\n".join(lines).encode())
        await reader.read()


@pytest.mark.parametrize(
    ("server", "advice"),
    [("AutobahnPython/17.10.1", FIREWALL_ADVICE), ("TornadoServer/6.4", ADDRESS_ADVICE)],
)
async def test_advice_is_what_works_for_this_rosbridge(server: str, advice: str):
    async with NamedServer(server) as rosbridge:
        assert await rosbridge_advice(f"ws://127.0.0.1:{rosbridge.port}") == advice


async def test_advice_names_both_ways_where_rosbridge_does_not_say_what_it_is():
    advice = await rosbridge_advice(f"ws://127.0.0.1:{free_port()}")
    assert ADDRESS_ADVICE in advice
    assert "ROS 1" in advice

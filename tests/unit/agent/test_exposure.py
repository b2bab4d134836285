"""What of the robot is reached from beyond it, as the kernel says, in a network of the test's own."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import namespaces
import pytest
from namespaces import Namespace
from robotether_agent.health import exposed_at, port_of

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="a network namespace needs root")


@pytest.fixture
def network() -> Iterator[None]:
    """A network that nobody else reaches."""
    made = Namespace(f"{namespaces.PREFIX}-{os.getpid()}-0-exposure", "")
    namespaces.make(made)
    with made.entered():
        yield
    namespaces.remove(made.name)


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
    """As ROS's own rosbridge listens, and as it should."""
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


@pytest.mark.parametrize(
    ("url", "port"),
    [("ws://127.0.0.1:9090/", 9090), ("http://robot/", 80), ("wss://robot", 443)],
)
def test_port_of_a_url(url, port):
    """The scheme's own, where the URL names none."""
    assert port_of(url) == port

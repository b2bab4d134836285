"""What the kernel says about its network: parsed whatever comes, reported when something changes."""

from __future__ import annotations

import asyncio
import os
import socket
import struct

import pytest
from namespaces import ip
from robotether_agent.net import netlink
from robotether_agent.net.netlink import kinds_of, listening


def message(number: int, body: bytes = b"") -> bytes:
    length = netlink.HEADER.size + len(body)
    return netlink.HEADER.pack(length, number, 0, 0, 0) + body + b"\0" * (-length % 4)


@pytest.mark.parametrize(
    ("data", "kinds"),
    [
        (b"", set()),
        (message(16), {"link"}),
        (message(20, b"12345") + message(25), {"address", "route"}),
        (message(3) + message(28), set()),
        (message(24)[:-1], set()),
        (message(20) + message(24)[:10], {"address"}),
        (struct.pack("=IHHII", 0, 24, 0, 0, 0) * 3, set()),
        (struct.pack("=IHHII", 2**32 - 1, 24, 0, 0, 0), set()),
        (b"\xff" * 70000, set()),
    ],
)
def test_messages_are_told_apart(data, kinds):
    assert kinds_of(data) == kinds


async def test_a_reader_takes_what_is_there():
    first, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    first.setblocking(False)
    network = netlink.Network()
    with first, other:
        other.send(message(3))
        network.read(first)
        assert not network._event.is_set()
        other.send(message(24))
        network.read(first)
        await asyncio.wait_for(network.changed(), 5)
        assert not network._event.is_set()


async def test_without_netlink_nothing_fails(monkeypatch):

    def refuse(*_: object):
        raise PermissionError("not here")

    with monkeypatch.context() as patched:
        patched.setattr(netlink.socket, "socket", refuse)
        made = netlink._open()
    assert made is None


@pytest.mark.skipif(os.geteuid() != 0, reason="changing an interface needs root")
async def test_the_kernel_is_heard():
    address = "127.213.17.1/32"
    with listening() as network:
        await asyncio.to_thread(ip, "address", "add", address, "dev", "lo")
        try:
            await asyncio.wait_for(network.changed(), 5)
        finally:
            await asyncio.to_thread(ip, "address", "del", address, "dev", "lo")

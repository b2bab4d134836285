"""A video proxy on the robot, reached over an emulated link as through ssh, for tests of what leaves it; needs root.

async with SlowUplink(link, proxy_port) as uplink:
    proxy.use(uplink.tunnel)
    connect to uplink.port, the server's end
"""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress
from typing import Self

from link import Link

# As ssh's own: what it takes before the other end has said that it could.
CHUNK = 32 * 1024


class SlowUplink:
    """One connection at a time of the server, carried over the link to the proxy."""

    def __init__(self, link: Link, proxy_port: int) -> None:
        self._proxy_port = proxy_port
        with link.robot.entered():
            self._inner = socket.create_server((link.robot.address, 0))
        with link.server.entered():
            there = socket.socket()
        there.connect(self._inner.getsockname())
        self._there = there
        self.tunnel, _ = self._inner.accept()
        self._outer = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._outer.getsockname()[1]
        for one in (self._there, self.tunnel, self._outer):
            one.setblocking(False)

    async def __aenter__(self) -> Self:
        self._task = asyncio.ensure_future(self._carry())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        for one in (self._outer, self._there, self.tunnel, self._inner):
            one.close()

    async def _carry(self) -> None:
        loop = asyncio.get_running_loop()
        client, _ = await loop.sock_accept(self._outer)
        proxy = socket.socket()
        with client, proxy:
            for one in (client, proxy):
                one.setblocking(False)
            await loop.sock_connect(proxy, ("127.0.0.1", self._proxy_port))
            pairs = [
                (client, self._there),
                (self._there, client),
                (self.tunnel, proxy),
                (proxy, self.tunnel),
            ]
            with suppress(OSError):
                await asyncio.gather(*(pump(*pair) for pair in pairs))


async def pump(source: socket.socket, sink: socket.socket) -> None:
    """Pass on what comes, no sooner than it is taken."""
    loop = asyncio.get_running_loop()
    while data := await loop.sock_recv(source, CHUNK):
        await loop.sock_sendall(sink, data)


async def drain(source: socket.socket, got: list[int]) -> None:
    """Take what comes, as the server's end does, and note how many bytes each time."""
    loop = asyncio.get_running_loop()
    while data := await loop.sock_recv(source, CHUNK):
        got.append(len(data))


def cubic_uplink(link: Link) -> tuple[socket.socket, socket.socket]:
    """Connect the robot's end to the server's by TCP at cubic; both ends in that order."""
    with link.server.entered():
        listener = socket.create_server((link.server.address, 0))
    with link.robot.entered():
        here = socket.socket()
        here.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, b"cubic")
        here.connect(listener.getsockname())
    there, _ = listener.accept()
    listener.close()
    return here, there

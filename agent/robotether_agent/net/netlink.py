"""Reports changes of this machine's links, addresses and routes (rtnetlink).

Used by dialler and liveness, each with a socket of its own. It only says that something changed; its users look for
themselves. Messages may be lost or not allowed at all: whoever waits here then looks a little later.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager

# Numbers of linux/rtnetlink.h.
GROUPS = {
    "link": 0x1,
    "IPv4 address": 0x10,
    "IPv4 route": 0x40,
    "IPv6 address": 0x100,
    "IPv6 route": 0x400,
}
BUFFER = 64 * 1024
# Maximum number of messages read at once; one change of network causes as many.
READS = 64

log = logging.getLogger(__name__)


class Network:
    """What one listener has received; `changed` waits for the next."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    async def changed(self) -> None:
        """Wait until something has changed since the last call."""
        await self._event.wait()
        self._event.clear()

    def read(self, listener: socket.socket) -> None:
        """Take what the kernel has sent: in these groups each message is a change."""
        for _ in range(READS):
            try:
                listener.recv(BUFFER)
            except BlockingIOError:
                return
            except OSError as error:
                # More happened than the buffer holds, so surely something did.
                if error.errno != errno.ENOBUFS:
                    return
            log.debug("the network changed")
            self._event.set()


@contextmanager
def listening() -> Iterator[Network]:
    """Listen inside the block."""
    network = Network()
    listener = _open()
    if listener is None:
        yield network
        return
    loop = asyncio.get_running_loop()
    loop.add_reader(listener, network.read, listener)
    try:
        yield network
    finally:
        loop.remove_reader(listener)
        listener.close()


def _open() -> socket.socket | None:
    try:
        kind = socket.SOCK_RAW | socket.SOCK_NONBLOCK
        listener = socket.socket(socket.AF_NETLINK, kind, socket.NETLINK_ROUTE)
    except OSError as error:
        log.debug("cannot watch for changes of the network: %s", error)
        return None
    try:
        listener.bind((0, sum(GROUPS.values())))
    except OSError as error:
        log.debug("cannot watch for changes of the network: %s", error)
        listener.close()
        return None
    return listener

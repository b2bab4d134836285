"""Reports changes of this machine's links, addresses and routes (rtnetlink).

Used by dialler and liveness, each with a socket of its own. It only says that something changed; its users look for
themselves. Messages may be lost or not allowed at all: whoever waits here then looks a little later.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager

# Numbers of linux/rtnetlink.h and linux/netlink.h.
GROUPS = {
    "link": 0x1,
    "IPv4 address": 0x10,
    "IPv4 route": 0x40,
    "IPv6 address": 0x100,
    "IPv6 route": 0x400,
}
KINDS = {16: "link", 17: "link", 20: "address", 21: "address", 24: "route", 25: "route"}
# Length, type, flags, sequence number and sender of each message.
HEADER = struct.Struct("=IHHII")
ALIGNMENT = 4
BUFFER = 64 * 1024
# Maximum number of messages read at once; one change of network causes as many.
READS = 64

log = logging.getLogger(__name__)


def kinds_of(data: bytes) -> set[str]:
    """Return what the messages in one datagram are about; what is cut short or unknown is left out."""
    kinds = set()
    at = 0
    while at + HEADER.size <= len(data):
        length, number, *_ = HEADER.unpack_from(data, at)
        if length < HEADER.size or at + length > len(data):
            break
        if number in KINDS:
            kinds.add(KINDS[number])
        at += -(-length // ALIGNMENT) * ALIGNMENT
    return kinds


class Network:
    """What one listener has received; `changed` waits for the next."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    async def changed(self) -> None:
        """Wait until something has changed since the last call."""
        await self._event.wait()
        self._event.clear()

    def read(self, listener: socket.socket) -> None:
        """Take what the kernel has sent."""
        for _ in range(READS):
            try:
                kinds = kinds_of(listener.recv(BUFFER))
            except BlockingIOError:
                return
            except OSError as error:
                # More happened than the buffer holds, so surely something did.
                kinds = {"link"} if error.errno == errno.ENOBUFS else set()
            if kinds:
                log.debug("the network changed: %s", ", ".join(sorted(kinds)))
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

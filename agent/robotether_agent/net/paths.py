"""Whether a connection still leaves this machine the way that a new one would; asks the kernel, sends nothing.

Used by reach. A look is a few system calls, so it may be done often.
"""

from __future__ import annotations

import errno
import socket
from enum import Enum


class Path(Enum):
    """What became of a connection's way out."""

    SAME = "same"
    # A new connection would leave from another address: another network, or another card.
    MOVED = "moved"
    # Its own address is no longer this machine's: nothing can come back to it.
    GONE = "gone"


def path_of(connection: socket.socket) -> Path:
    """Return what became of the way of a connection that stands or stood."""
    try:
        here, there = connection.getsockname(), connection.getpeername()
    except OSError:
        # It ended by itself, which shows elsewhere.
        return Path.SAME
    if not _is_ours(connection.family, here):
        return Path.GONE
    now = _source_towards(connection.family, there)
    return Path.SAME if now in {None, here[0]} else Path.MOVED


def _is_ours(family: int, address: tuple[object, ...]) -> bool:
    host, _, *rest = address
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, 0, *rest))
        except OSError as error:
            return error.errno != errno.EADDRNOTAVAIL
    return True


def _source_towards(family: int, address: tuple[object, ...]) -> object:
    """Return the address that a new connection would come from, None without a route."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address)
        except OSError:
            return None
        return probe.getsockname()[0]

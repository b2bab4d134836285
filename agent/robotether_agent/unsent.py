"""Keeps the unsent part of an answer small: bytes that wait in this computer get old, and nothing overtakes them."""

from __future__ import annotations

import socket
from contextlib import suppress

from aiohttp import web

# Size of the kernel's send buffer.
SEND_BYTES = 16 * 1024


def keep_little_unsent(request: web.BaseRequest) -> None:
    """Have this process and the kernel keep little of the answer that is not under way."""
    transport = request.transport
    if transport is None:
        return
    transport.set_write_buffer_limits(high=0)
    connection = transport.get_extra_info("socket")
    if connection is not None:
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)

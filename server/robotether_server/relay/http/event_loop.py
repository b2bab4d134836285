"""The relay's event loop: uvloop's, which must never close a connection that it does not own.

`main` runs everything in it.
"""

from __future__ import annotations

import socket
from typing import Any

import uvloop


class EventLoop(uvloop.Loop):
    """uvloop's, with one defect mended.

    When a connection over an open socket fails, uvloop 0.23 closes the file descriptor, and the socket does not know.
    It would close the number once more when it is collected, which may be that of a robot's or a driver's connection by
    then (https://github.com/MagicStack/uvloop/issues/738). aiohttp connects that way.
    """

    async def create_connection(
        self, *args: Any, sock: socket.socket | None = None, **options: Any
    ) -> Any:
        """Connect as usual; a `sock` with which that failed has no file descriptor any more."""
        try:
            return await super().create_connection(*args, sock=sock, **options)
        except BaseException:
            if sock is not None:
                sock.detach()
            raise

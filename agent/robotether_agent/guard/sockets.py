"""The two ends of a client proxy, and the publisher's: aiohttp WebSockets that keep text as bytes.

Nothing is compressed, pings and pongs go on to the other side as they come, and each end tells how much of what
was sent is still in this process.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, Literal, cast

from aiohttp import ClientResponse, ClientSession, ClientWebSocketResponse, TCPConnector, web
from aiohttp import ClientWSTimeout as Timeouts

from robotether_agent.tasks import within

# Beyond this an end counts as full, and the other end is not read on.
SEND_BUFFER_BYTES = 64 * 1024
FROM_ROBOT_BYTES = 64 * 1024 * 1024
# The relay takes 10 MB; reading a message holds up all others, and the zeros.
FROM_CLIENT_BYTES = 16 * 1024 * 1024
CONNECT_WITHIN_S = 3.0
FAREWELL_S = 0.5


class ClientSocket(web.WebSocketResponse[Literal[False]]):
    """The operator's end."""

    def __init__(self) -> None:
        super().__init__(
            timeout=FAREWELL_S,
            autoping=False,
            compress=False,
            max_msg_size=FROM_CLIENT_BYTES,
            writer_limit=SEND_BUFFER_BYTES,
            decode_text=False,
        )
        self._transport: asyncio.Transport | None = None

    async def open(self, request: web.BaseRequest) -> None:
        """Answer the upgrade."""
        self._transport = request.transport
        if self._transport is not None:
            self._transport.set_write_buffer_limits(high=SEND_BUFFER_BYTES)
        await self.prepare(request)

    def waiting_bytes(self) -> int:
        """Tell how much of what was sent is still in this process."""
        return self._transport.get_write_buffer_size() if self._transport else 0

    async def leave(self, code: int) -> None:
        """Say goodbye, without waiting for long for a client that does not read."""
        with suppress(asyncio.TimeoutError, ConnectionError):
            await within(FAREWELL_S, self.close(code=code))

    def drop(self) -> None:
        """End the connection at once; a client that has taken all that was sent keeps it, and its reason."""
        if self._transport is None:
            return
        if self._transport.get_write_buffer_size():
            self._transport.abort()
        else:
            self._transport.close()


class RosbridgeSocket(ClientWebSocketResponse[Literal[False]]):
    """rosbridge's end; aiohttp makes it as the session's `ws_response_class`."""

    def __init__(
        self, reader: Any, writer: Any, protocol: Any, response: Any, *args: Any, **kwargs: Any
    ) -> None:
        super().__init__(reader, writer, protocol, response, *args, **kwargs)
        self._answer: ClientResponse = response
        self._transport: asyncio.Transport = writer.transport
        self._transport.set_write_buffer_limits(high=SEND_BUFFER_BYTES)

    def waiting_bytes(self) -> int:
        """Tell how much of what was sent is still in this process."""
        return self._transport.get_write_buffer_size()

    async def leave(self) -> None:
        """Say goodbye, without waiting for long for a rosbridge that does not read."""
        with suppress(asyncio.TimeoutError, ConnectionError):
            await within(FAREWELL_S, self.close())

    def drop(self) -> None:
        """End the connection at once, also that of a socket that broke, which aiohttp keeps."""
        # Not closed, which would wait without end for a rosbridge that does not take what is sent already.
        self._transport.abort()
        self._answer.close()


def new_http() -> ClientSession:
    """Return the session with which all connections to rosbridge are made."""
    return ClientSession(
        connector=TCPConnector(limit=0),
        ws_response_class=cast("type[ClientWebSocketResponse]", RosbridgeSocket),
    )


async def open_rosbridge(http: ClientSession, url: str) -> RosbridgeSocket:
    """Return a new connection; aiohttp.ClientError, OSError or asyncio.TimeoutError when there is none."""
    socket = await within(
        CONNECT_WITHIN_S,
        http.ws_connect(
            url,
            timeout=Timeouts(ws_close=FAREWELL_S),
            autoping=False,
            max_msg_size=FROM_ROBOT_BYTES,
            decode_text=False,
        ),
    )
    if not isinstance(socket, RosbridgeSocket):
        raise TypeError("the session makes sockets of another class")
    return socket

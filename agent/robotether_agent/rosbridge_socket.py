"""A WebSocket to rosbridge that passes frames on as they are; `rosbridge` reads those of the agent's own.

Text stays bytes, nothing is compressed, and a socket knows how much of what was sent is still in this process.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, Literal, cast

from aiohttp import (
    ClientResponse,
    ClientSession,
    ClientWebSocketResponse,
    TCPConnector,
    TraceConfig,
    TraceRequestRedirectParams,
    WebSocketError,
    WSCloseCode,
    WSMsgType,
    WSServerHandshakeError,
)
from aiohttp import ClientWSTimeout as Timeouts
from aiohttp.http_websocket import WSMessageNoDecodeText

from robotether_agent.fields import printable
from robotether_agent.tasks import within

CONNECT_WITHIN_S = 3.0
FAREWELL_S = 0.5
# Maximum size of a message of rosbridge.
FROM_ROBOT_BYTES = 64 * 1024 * 1024
# Maximum unsent size before a socket counts as full and the other end is no longer read.
SEND_BUFFER_BYTES = 64 * 1024


# Maximum size of a close reason: a control frame carries 125 bytes, two of them the code (RFC 6455).
MAX_REASON_BYTES = 123


def close_reason(words: str) -> bytes:
    """Return words as the reason in a close frame, cut between characters."""
    return printable(words).encode()[:MAX_REASON_BYTES].decode(errors="ignore").encode()


def is_too_large(message: WSMessageNoDecodeText) -> bool:
    """Return whether a connection ended with a message of rosbridge over the limit."""
    error = message.data
    return isinstance(error, WebSocketError) and error.code == WSCloseCode.MESSAGE_TOO_BIG


def why_ended(message: WSMessageNoDecodeText) -> str:
    """Say why rosbridge's connection is over, whose last message this is; empty: rosbridge did not say."""
    if message.type is WSMsgType.CLOSE:
        return message.extra or ""
    if is_too_large(message):
        return f"a message has over {FROM_ROBOT_BYTES >> 20} MB, the limit of the robot's agent"
    return "the connection to rosbridge broke"


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
        """Return how much of what was sent is still in this process."""
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
    """Return the session with which all connections to rosbridge are made; it follows no redirect."""
    trace = TraceConfig()
    trace.on_request_redirect.append(_refuse_redirect)
    return ClientSession(
        connector=TCPConnector(limit=0),
        trace_configs=[trace],
        ws_response_class=cast("type[ClientWebSocketResponse]", RosbridgeSocket),
    )


async def _refuse_redirect(
    _client: object, _context: object, redirect: TraceRequestRedirectParams
) -> None:
    """Raise that this is no rosbridge: it may lead to another robot's, or to a name that ends the process."""
    answer = redirect.response
    answer.close()
    raise WSServerHandshakeError(answer.request_info, answer.history, status=answer.status)


async def open_rosbridge(
    http: ClientSession,
    url: str,
    *,
    max_message_bytes: int | None = None,
    heartbeat_s: float | None = None,
) -> RosbridgeSocket:
    """Return a new connection; aiohttp.ClientError, OSError or asyncio.TimeoutError when there is none.

    Pings and pongs are its user's, unless it is pinged each `heartbeat_s`.
    """
    connection = await within(
        CONNECT_WITHIN_S,
        http.ws_connect(
            url,
            timeout=Timeouts(ws_close=FAREWELL_S),
            autoping=heartbeat_s is not None,
            heartbeat=heartbeat_s,
            max_msg_size=max_message_bytes or FROM_ROBOT_BYTES,
            decode_text=False,
        ),
    )
    if not isinstance(connection, RosbridgeSocket):
        raise TypeError("the session makes sockets of another class")
    return connection

"""The two ends of a bridge: aiohttp WebSockets that pass bytes on.

`rosbridge` makes one of each a connection. Text stays bytes, compression is off, and both know how
much of what was sent is still in this program. Nothing here decides when a connection ends.
"""

from __future__ import annotations

import asyncio
import logging
import struct
import time
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from socket import IPPROTO_TCP, SO_SNDBUF, SOL_SOCKET, TCP_INFO, TCP_NOTSENT_LOWAT
from types import SimpleNamespace
from typing import Any, Literal, NoReturn, cast

from aiohttp import (
    ClientError,
    ClientResponse,
    ClientSession,
    ClientWebSocketResponse,
    ClientWSTimeout,
    DummyCookieJar,
    TCPConnector,
    TraceConfig,
    TraceRequestRedirectParams,
    WebSocketError,
    WSCloseCode,
    WSMsgType,
    WSServerHandshakeError,
    web,
)
from aiohttp.abc import AbstractStreamWriter
from aiohttp.http_websocket import WSMessageNoDecodeText
from robotether_common.guard import REASON_HEADER
from yarl import URL

from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.event_loop import PIECE_BYTES, PieceTurns, next_turn
from robotether_server.relay.http.timing import Liveness, LivenessLimits
from robotether_server.tasks import end_tasks

log = logging.getLogger(__name__)

# Time for which a name server's answer is kept: sshd may come back with another address.
NAMES_KEPT_S = 2

# Maximum unsent size before an end counts as full and the other end is no longer read.
SEND_BUFFER_BYTES = 64 * 1024
# Size of the kernel's buffer of a driver's messages, which Linux doubles.
DRIVE_SEND_BYTES = 32 * 1024
# Maximum unsent size in the kernel of a viewer's frames.
UNSENT_BYTES = 32 * 1024
# Time limits for an operator, and a robot, to read waiting messages and answer the close.
OPERATOR_FAREWELL_S = 2.0
ROBOT_FAREWELL_S = 0.5
# Close code that RFC 6455 reserves for connections that ended without a close frame.
NEVER_SENT = 1006
# Margin of aiohttp's limit, which rejects a message of exactly that size.
LIMIT_MARGIN = 1
# Maximum length of a robot's own words for why it refused or closed a connection.
MAX_ROBOT_REASON = 200
# First bytes of a whole message (RFC 6455, 5.2).
WHOLE_TEXT, WHOLE_BINARY = 0x81, 0x82
# linux/tcp.h, struct tcp_info: `tcpi_bytes_received`, since Linux 4.1.
RECEIVED_BYTES = struct.Struct("=128xQ")


class OperatorSocket(web.WebSocketResponse[Literal[False]]):
    """The operator's end; only `finish` closes it, with a reason, and lets the reason arrive."""

    def __init__(self, message_limit: int) -> None:
        super().__init__(
            autoclose=False,
            autoping=False,
            compress=False,
            max_msg_size=message_limit + LIMIT_MARGIN,
            writer_limit=SEND_BUFFER_BYTES,
            decode_text=False,
        )
        self.message_limit = message_limit
        self._transport: asyncio.Transport | None = None
        self._stream: AbstractStreamWriter | None = None
        # Held while a large message is sent, and how much of it is not handed over yet.
        self._sending_large = asyncio.Lock()
        self._left_bytes = 0

    async def open(self, request: web.Request) -> None:
        """Answer the upgrade; from now on `drained` waits until this program holds little back."""
        self._transport = request.transport
        if self._transport is not None:
            self._transport.set_write_buffer_limits(high=SEND_BUFFER_BYTES)
        self._stream = await self.prepare(request)

    async def close(self, *, code: int = 1000, message: bytes = b"", drain: bool = True) -> bool:
        """Do nothing: aiohttp calls this by itself, and knows no reason to give the client."""
        return False

    def waiting_bytes(self) -> int:
        """Return how much of what was sent is still in this program."""
        return _waiting(self._transport) + self._left_bytes

    async def drained(self) -> None:
        """Wait until what waits is little; ConnectionError when it never will be."""
        if self._stream is not None:
            await self._stream.drain()

    async def send_message(self, message: bytes, kind: WSMsgType, turns: PieceTurns) -> None:
        """Send a message; a large one in pieces, between which others have turns."""
        if len(message) > SEND_BUFFER_BYTES:
            await self.send_large(message, kind, turns)
        else:
            await self.send_frame(message, kind)

    async def send_large(self, message: bytes, kind: WSMsgType, turns: PieceTurns) -> None:
        """Send a message in pieces, none of which is copied, each in its turn."""
        async with self._sending_large:
            rest = memoryview(message)
            first = WHOLE_TEXT if kind is WSMsgType.TEXT else WHOLE_BINARY
            self._write(websocket_header(first, len(message)))
            try:
                while rest:
                    self._left_bytes = len(rest)
                    await turns.next()
                    self._write(rest[:PIECE_BYTES])
                    rest = rest[PIECE_BYTES:]
                    self._left_bytes = len(rest)
                    await self.drained()
            finally:
                self._left_bytes = 0
                # A client reads a close frame only behind the whole message.
                if rest and self._is_open:
                    self._write(rest)

    def send_at_once(self, message: bytes, kind: WSMsgType) -> bool:
        """Send a message if nothing waits before it; False: it was not sent."""
        if not self._is_open or self.waiting_bytes() or self._sending_large.locked():
            return False
        first = WHOLE_TEXT if kind is WSMsgType.TEXT else WHOLE_BINARY
        self._write(websocket_header(first, len(message)) + message)
        return True

    async def send_frame(
        self, message: bytes, opcode: WSMsgType, compress: int | None = None
    ) -> None:
        """Send a frame, behind a large message that is being sent."""
        await self._large_sent()
        await super().send_frame(message, opcode, compress)

    async def ping(self, message: bytes = b"") -> None:
        """Send a ping, behind a large message that is being sent."""
        await self._large_sent()
        await super().ping(message)

    async def pong(self, message: bytes = b"") -> None:
        """Send a pong, behind a large message that is being sent."""
        await self._large_sent()
        await super().pong(message)

    async def _large_sent(self) -> None:
        if self._sending_large.locked():
            async with self._sending_large:
                pass

    @property
    def _is_open(self) -> bool:
        return self._transport is not None and not self._transport.is_closing()

    def _write(self, data: bytes | memoryview) -> None:
        if self._transport is None or self._transport.is_closing():
            raise ConnectionResetError("the client's connection is closed")
        self._transport.write(data)

    async def finish(self, close_reason: CloseReason) -> None:
        """Send the close frame and give the client some time to read it and to answer."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        if close_reason.code == NEVER_SENT:
            transport.abort()
            return
        try:
            async with asyncio.timeout(OPERATOR_FAREWELL_S):
                payload = struct.pack("!H", close_reason.code) + close_reason.reason_bytes
                await self.send_frame(payload, WSMsgType.CLOSE)
                await self._answered(transport)
        except (TimeoutError, ConnectionError):
            transport.abort()

    async def goodbye_code(self) -> int | None:
        """Return of a connection that is gone the code of the close frame that came last, None without one."""
        if self._transport is None or not self._transport.is_closing():
            return None
        while True:
            message = await self.receive()
            if message.type in {WSMsgType.CLOSE, WSMsgType.CLOSING}:
                return None if self.close_code == NEVER_SENT else self.close_code
            if message.type in {WSMsgType.CLOSED, WSMsgType.ERROR}:
                return None

    async def _answered(self, transport: asyncio.Transport) -> None:
        """Wait for the client's close frame.

        After a message over the limit aiohttp reads nothing more but still empties the socket:
        closing a socket with unread input would reset it, and the client would lose the reason.
        """
        while not transport.is_closing():
            message = await self.receive()
            if message.type in {WSMsgType.CLOSE, WSMsgType.CLOSING, WSMsgType.CLOSED}:
                return
            # A client that is closed for a flood may go on with it: others have a turn after each message.
            await asyncio.sleep(0.05 if message.type is WSMsgType.ERROR else 0)


class ViewerSocket(OperatorSocket):
    """An observer's end: takes messages that are written already, which viewers share, and never copies them."""

    async def open(self, request: web.Request) -> None:
        """Answer the upgrade; from now on `drained` waits until this program holds nothing back."""
        self._transport = request.transport
        if self._transport is not None:
            keep_little_unsent(self._transport)
        self._stream = await self.prepare(request)

    def write_message(self, message: bytes) -> None:
        """Hand over a whole WebSocket message with its header."""
        if self._is_open:
            self._write(message)


class OperatorConnection:
    """Runs the parts of an operator's connection beside each other, until one of them or somebody else ends it."""

    def __init__(self, robot: str) -> None:
        self.name = robot
        self._ended: asyncio.Future[CloseReason] = asyncio.get_running_loop().create_future()

    def end(self, close_reason: CloseReason) -> None:
        """End the connection at once; the first ending counts."""
        if not self._ended.done():
            self._ended.set_result(close_reason)

    async def _run_until_ended(self, work: Coroutine[Any, Any, CloseReason]) -> CloseReason:
        """Run the work; all of it is still before this returns, as the close frame is the last."""
        task = asyncio.create_task(self._guard(work), name=f"connection to {self.name}")
        try:
            return await self._ended
        finally:
            await end_tasks([task])

    async def _run_together(self, *parts: Coroutine[Any, Any, CloseReason]) -> CloseReason:
        async with asyncio.TaskGroup() as group:
            for part in parts:
                group.create_task(self._guard(part))
        return await self._ended

    async def _guard(self, part: Coroutine[Any, Any, CloseReason]) -> None:
        """Run a part; its end, or its defect, ends the connection."""
        try:
            self.end(await part)
        except ConnectionClosedError as exc:
            self.end(exc.close_reason)
        except ConnectionError:
            self.end(close_reasons.client_vanished(self.name))
        except Exception:
            log.exception("robot %s: an operator's connection failed", self.name)
            self.end(close_reasons.relay_failed())


class ClientConnection(OperatorConnection):
    """A connection whose client has a WebSocket, and is watched and pinged."""

    def __init__(self, robot: str, socket: OperatorSocket, limits: LivenessLimits) -> None:
        super().__init__(robot)
        self._socket = socket
        self._limits = limits
        # What `_watch` judges by.
        self._received_s = time.monotonic()
        self._bytes_to_client = 0

    async def close_reason_of_gone(self) -> CloseReason:
        """Return why a connection that is gone ended, by the frames that nobody has read yet."""
        code = await self._socket.goodbye_code()
        if code is None:
            return close_reasons.client_vanished(self.name)
        return self._close_reason_by_code(code)

    async def _run_together(self, *parts: Coroutine[Any, Any, CloseReason]) -> CloseReason:
        return await super()._run_together(*parts, self._watch(), self._ping())

    async def _receive(self) -> WSMessageNoDecodeText:
        message = await self._socket.receive()
        self._received_s = time.monotonic()
        return message

    async def _watch(self) -> CloseReason:
        """Return why, once the client is silent or slow, or the other side slow."""
        limits = self._limits
        liveness = Liveness(limits, time.monotonic())
        while True:
            await asyncio.sleep(limits.check_every_s)
            verdict = liveness.check(
                time.monotonic(),
                received_at=self._received_s,
                to_client=(self._bytes_to_client, self._socket.waiting_bytes()),
                to_robot=self._to_robot(),
            )
            if verdict == "client_silent":
                return close_reasons.client_silent(self.name, limits.silent_after_s)
            if verdict == "client_slow":
                return close_reasons.client_slow(self.name, limits.slow_after_s)
            if verdict == "robot_slow":
                return self._robot_slow(limits.slow_after_s)

    async def _ping(self) -> CloseReason:
        """Ping the client; apart from the watch, because a client that takes nothing holds this up."""
        while True:
            await asyncio.sleep(self._limits.ping_every_s)
            # Behind data that waits a ping would only wait too.
            if self._limits.strict or not self._socket.waiting_bytes():
                await self._socket.ping(self._next_ping())

    def _next_ping(self) -> bytes:
        return b""

    def _to_robot(self) -> tuple[int, int]:
        """Return how many bytes were written to the other side, and how many of them wait."""
        return 0, 0

    def _robot_slow(self, _limit_s: float) -> CloseReason:
        return close_reasons.link_lost(self.name)

    def _close_reason_by_client(self, last: WSMessageNoDecodeText) -> CloseReason:
        """Return why the client's end ended, by what was read last."""
        if last.type is WSMsgType.CLOSE:
            return self._close_reason_by_code(last.data)
        if isinstance(last.data, WebSocketError):
            return close_reason_of_broken(last.data, "you", self._socket.message_limit)
        return close_reasons.client_vanished(self.name)

    def _close_reason_by_code(self, _code: int) -> CloseReason:
        return close_reasons.client_left(self.name)


def close_reason_of_broken(error: WebSocketError, sender: str, limit: int) -> CloseReason:
    """Return why a connection ended on which that side sent what nobody reads, or too much of it."""
    if error.code == WSCloseCode.MESSAGE_TOO_BIG:
        return close_reasons.message_too_big(limit, sender)
    return close_reasons.protocol_broken(sender)


class RobotSocket(ClientWebSocketResponse[Literal[False]]):
    """The robot's end; aiohttp makes it as the session's `ws_response_class`."""

    def __init__(
        self, reader: Any, writer: Any, protocol: Any, response: Any, *args: Any, **kwargs: Any
    ) -> None:
        super().__init__(reader, writer, protocol, response, *args, **kwargs)
        self._answer: ClientResponse = response
        self._transport: asyncio.Transport = writer.transport
        self._transport.set_write_buffer_limits(high=SEND_BUFFER_BYTES)
        self._turn = 0
        # Bytes of messages that were handed over.
        self.sent_bytes = 0

    async def send_frame(
        self, message: bytes, opcode: WSMsgType, compress: int | None = None
    ) -> None:
        """Send a message, and count it."""
        self.sent_bytes += len(message)
        await super().send_frame(message, opcode, compress)

    async def next_message(
        self, on_control: Callable[[WSMsgType, bytes], None] = lambda _kind, _payload: None
    ) -> WSMessageNoDecodeText:
        """Return the next message, or how the connection ended; meanwhile answer pings, and let others have turns.

        `on_control` is called for each ping and pong before it, with its payload.
        """
        while True:
            self._turn = await next_turn(self._turn)
            message = await self.receive()
            if message.type is not WSMsgType.PING and message.type is not WSMsgType.PONG:
                return message
            on_control(message.type, message.data)
            if message.type is WSMsgType.PING:
                # Why it broke is what is read next.
                with suppress(ConnectionError):
                    await self.pong(message.data)

    def waiting_bytes(self) -> int:
        """Return how much of what was sent is still in this program."""
        return _waiting(self._transport)

    def received_bytes(self) -> int | None:
        """Return how much has come, also of a message that is still on the way; None: the kernel does not say."""
        connection = self._transport.get_extra_info("socket")
        try:
            info = connection.getsockopt(IPPROTO_TCP, TCP_INFO, RECEIVED_BYTES.size)
            return int(RECEIVED_BYTES.unpack(info)[0])
        except (AttributeError, OSError, ValueError, struct.error):
            # It is closed, or the kernel an old one.
            return None

    def keep_little(self) -> None:
        """Have the system keep little of what is sent: drive commands must not grow old in it."""
        socket = self._transport.get_extra_info("socket")
        if socket is not None:
            socket.setsockopt(SOL_SOCKET, SO_SNDBUF, DRIVE_SEND_BYTES)

    async def leave(self) -> None:
        """Close towards the robot, without waiting for one that does not read."""
        try:
            async with asyncio.timeout(ROBOT_FAREWELL_S):
                await self.close()
        except (TimeoutError, ConnectionError):
            self._transport.abort()

    def drop(self) -> None:
        """Give the connection back, also that of a socket that broke, which aiohttp keeps."""
        self._answer.close()


async def connect_robot(
    client: ClientSession,
    url: URL,
    message_limit: int,
    *,
    headers: Mapping[str, str] | None = None,
    **options: Any,
) -> RobotSocket:
    """Open a WebSocket to a robot, or to its cell, whose pings the caller answers; raise aiohttp's ClientError."""
    socket = await client.ws_connect(
        url,
        headers=headers,
        autoping=False,
        compress=0,
        decode_text=False,
        max_msg_size=message_limit + LIMIT_MARGIN,
        timeout=ClientWSTimeout(ws_close=ROBOT_FAREWELL_S),
        **options,
    )
    return cast(RobotSocket, socket)


def why_refused(error: WSServerHandshakeError, usual: str = "") -> str:
    """Return why a robot refused a WebSocket, in its own words; an older agent gives none."""
    words = own_words(error.headers.get(REASON_HEADER)) if error.headers else ""
    return words or usual or f"it answered HTTP {error.status}"


def why_closed(close: WSMessageNoDecodeText) -> str:
    """Return why a robot closed a connection, in its own words if it has any."""
    return own_words(close.extra) or "it closed the connection"


def own_words(text: object) -> str:
    """Return what a robot says of itself if people may read it, else an empty text."""
    is_fit = isinstance(text, str) and text.isprintable()
    return str(text)[:MAX_ROBOT_REASON] if is_fit else ""


def keep_little_unsent(transport: asyncio.Transport) -> None:
    """Have program and system keep little that is not under way: what waits there only grows old."""
    transport.set_write_buffer_limits(high=0)
    socket = transport.get_extra_info("socket")
    if socket is not None:
        socket.setsockopt(IPPROTO_TCP, TCP_NOTSENT_LOWAT, UNSENT_BYTES)


def websocket_header(first: int, size: int) -> bytes:
    """Write the WebSocket header (RFC 6455, 5.2) of a whole message without a mask."""
    if size < 126:  # noqa: PLR2004  # the RFC's own number
        return struct.pack("!BB", first, size)
    if size < 2**16:
        return struct.pack("!BBH", first, 126, size)
    return struct.pack("!BBQ", first, 127, size)


def _waiting(transport: asyncio.Transport | None) -> int:
    if transport is None or transport.is_closing():
        return 0
    return transport.get_write_buffer_size()


class RedirectedError(ClientError):
    """A robot answered with a redirect."""


def robot_client() -> ClientSession:
    """Make the HTTP client towards robots; it keeps no connection and no cookie."""
    return ClientSession(
        connector=TCPConnector(limit=0, force_close=True, ttl_dns_cache=NAMES_KEPT_S),
        cookie_jar=DummyCookieJar(),
        auto_decompress=False,
        # aiohttp names what it could read with the packages that are there; robots are asked for the same everywhere.
        headers={"Accept-Encoding": "gzip, deflate"},
        trace_configs=[refuse_redirects()],
        # aiohttp declares the class for text that it decodes; ours never does.
        ws_response_class=cast(type[ClientWebSocketResponse], RobotSocket),
    )


def refuse_redirects() -> TraceConfig:
    """Return what makes a client raise RedirectedError in place of following a redirect.

    aiohttp follows redirects when it opens a WebSocket, and has no setting against that. A robot whose key was
    stolen could so lead the connection of its own driver to another robot's port, or anywhere else on the relay's
    networks.
    """
    trace = TraceConfig()
    trace.on_request_redirect.append(_refuse)
    return trace


async def _refuse(
    _client: ClientSession, _context: SimpleNamespace, redirect: TraceRequestRedirectParams
) -> NoReturn:
    # Before anything else is done with it: the connection must not stay open in the pool.
    redirect.response.close()
    raise RedirectedError("it answered with a redirect, which is not followed")

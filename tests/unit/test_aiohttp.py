"""What relay and agent use of aiohttp beyond its documentation, with aiohttp alone.

A test that fails here says what a new aiohttp changed; it names the code that relies on it. pyproject.toml of agent and
server bound the version: raise the bound when these tests pass. Redirects, which aiohttp follows for WebSockets too,
have their test beside the code that refuses them (relay/http/test_sockets.py).
"""

from __future__ import annotations

import asyncio
import inspect
import logging
import os
import re
import ssl
import struct
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import aiohttp
import pytest
from aiohttp import (
    ClientSession,
    ClientWebSocketResponse,
    WebSocketError,
    WSCloseCode,
    WSMsgType,
    web,
)
from aiohttp.http_exceptions import HttpProcessingError
from fake_cloud import certificate
from robotether_agent import rosbridge as _agent_sockets  # noqa: F401 - for its classes
from robotether_agent.guard import process as _guard_sockets  # noqa: F401 - for its classes
from robotether_server.relay import main as _relay_sockets  # noqa: F401 - for its classes

HOST = "127.0.0.1"
WAIT_S = 30
FAREWELL_S = 0.1
LIMIT = 1000
ASSIGNED = re.compile(r"\bself\.(\w+)(?:: [^=\n]+)? = ")
# OperatorSocket closes in its own way, and only when told to, and sends each of these behind a large message.
OVERRIDDEN = {"close", "ping", "pong", "send_frame"}

Talk = Callable[[web.WebSocketResponse], Awaitable[None]]


@asynccontextmanager
async def connected(
    talk: Talk, kind: type[web.WebSocketResponse] = web.WebSocketResponse, **options: object
) -> AsyncIterator[ClientWebSocketResponse]:
    """A client's WebSocket to a server that talks as a test says, with these options at both ends."""
    problems: list[BaseException] = []

    async def handle(request: web.Request) -> web.StreamResponse:
        socket = kind(
            timeout=FAREWELL_S, compress=False, max_msg_size=LIMIT, autoclose=False, **options
        )
        socket.aside = request.transport
        socket.stream = await socket.prepare(request)
        try:
            await talk(socket)
        except Exception as error:
            problems.append(error)
            raise
        return socket

    runner = web.ServerRunner(web.Server(handle, access_log=None), shutdown_timeout=0.1)
    await runner.setup()
    site = web.TCPSite(runner, HOST, 0)
    await site.start()
    try:
        async with ClientSession() as session:
            url = f"http://{HOST}:{runner.addresses[0][1]}/"
            timeouts = aiohttp.ClientWSTimeout(ws_close=FAREWELL_S)
            limits = {"timeout": timeouts, "max_msg_size": 0, "compress": 0, "autoclose": False}
            async with session.ws_connect(url, **limits, **options) as client:
                async with asyncio.timeout(WAIT_S):
                    yield client
        assert problems == []
    finally:
        await runner.cleanup()


async def closed(socket: web.WebSocketResponse | ClientWebSocketResponse) -> None:
    """Read to the end."""
    while (await socket.receive()).type not in {WSMsgType.CLOSE, WSMsgType.CLOSED, WSMsgType.ERROR}:
        pass


def own_classes() -> list[type]:
    """Every class of the product that is one of aiohttp's WebSockets."""
    left: list[type] = [web.WebSocketResponse, ClientWebSocketResponse]
    found = []
    while left:
        left += (below := left.pop().__subclasses__())
        found += [item for item in below if item.__module__.startswith("robotether_")]
    return sorted(found, key=lambda item: item.__qualname__)


def names_of(cls: type) -> set[str]:
    """The methods of one class, and the attributes that it sets."""
    methods = {name for name in vars(cls) if not name.startswith(("__", "_abc_"))}
    return methods | set(ASSIGNED.findall(inspect.getsource(cls)))


def test_the_product_has_websockets_of_its_own() -> None:
    """Those that the next test looks at."""
    assert {
        "OperatorSocket",
        "ViewerSocket",
        "RobotSocket",
        "ClientSocket",
        "RosbridgeSocket",
    } <= {kind.__name__ for kind in own_classes()}


@pytest.mark.parametrize("cls", own_classes(), ids=lambda cls: cls.__qualname__)
def test_our_names_are_free_in_aiohttps_classes(cls: type) -> None:
    """An attribute of ours that a new aiohttp has too would replace its own."""
    theirs = set()
    for base in cls.__mro__:
        if base.__module__.startswith("aiohttp."):
            theirs |= names_of(base)
    assert names_of(cls) & theirs - OVERRIDDEN == set()


def test_a_clients_websocket_is_made_of_reader_writer_protocol_and_response() -> None:
    """RobotSocket and RosbridgeSocket take these, and pass on what follows."""
    made_of = list(inspect.signature(ClientWebSocketResponse.__init__).parameters)
    assert made_of[:5] == ["self", "reader", "writer", "protocol", "response"]


async def test_the_writer_of_a_clients_websocket_has_its_transport() -> None:
    """RobotSocket and RosbridgeSocket bound its buffer, ask how much waits in it, and abort it."""
    made: list[tuple[object, aiohttp.ClientResponse]] = []

    class Kept(ClientWebSocketResponse):
        def __init__(self, reader, writer, protocol, response, *args, **kwargs):
            super().__init__(reader, writer, protocol, response, *args, **kwargs)
            made.append((writer.transport, response))

    async def handle(request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        await closed(socket)
        return socket

    runner = web.ServerRunner(web.Server(handle, access_log=None), shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, HOST, 0).start()
    try:
        async with ClientSession(ws_response_class=Kept) as session:
            socket = await session.ws_connect(f"http://{HOST}:{runner.addresses[0][1]}/")
            [(transport, response)] = made
            assert type(socket) is Kept, "the class of ws_response_class is made as it is"
            assert response.connection is not None
            assert transport is response.connection.transport
            assert isinstance(transport, asyncio.Transport)
            # `drop` of both: nothing else gives a broken WebSocket's connection back.
            response.close()
            assert transport.is_closing(), "closing the answer closes the connection"
    finally:
        await runner.cleanup()


@pytest.mark.parametrize("size", [LIMIT - 1, LIMIT])
async def test_a_message_as_large_as_the_limit_is_refused(size: int) -> None:
    """So limits are one more than what we allow (LIMIT_MARGIN); a refusal is a WebSocketError with its code."""
    received = []

    async def talk(socket: web.WebSocketResponse) -> None:
        received.append(await socket.receive())

    async with connected(talk) as client:
        await client.send_bytes(b"x" * size)
        await closed(client)
    [message] = received
    if size < LIMIT:
        assert (message.type, len(message.data)) == (WSMsgType.BINARY, size)
    else:
        assert message.type is WSMsgType.ERROR
        assert isinstance(message.data, WebSocketError)
        assert message.data.code == WSCloseCode.MESSAGE_TOO_BIG


async def test_a_refused_message_is_closed_by_a_method_that_can_be_replaced() -> None:
    """OperatorSocket.close does nothing: then reading goes on to report the error, and the input is still emptied."""
    types = []

    class Silent(web.WebSocketResponse):
        async def close(self, **_options: object) -> bool:
            return False

    async def talk(socket: web.WebSocketResponse) -> None:
        types.extend([(await socket.receive()).type for _ in range(3)])
        payload = struct.pack("!H", 4400) + b"because"
        await socket.send_frame(payload, WSMsgType.CLOSE)
        await asyncio.sleep(0.2)

    async with connected(talk, Silent) as client:
        for _ in range(100):
            await client.send_bytes(b"x" * 100_000)
        message = await client.receive()
        assert (message.type, message.data, message.extra) == (WSMsgType.CLOSE, 4400, "because")
    assert types == [WSMsgType.ERROR] * 3


async def test_what_is_written_to_the_transport_stands_in_order() -> None:
    """ViewerSocket.write_message: aiohttp's own writer holds nothing back, before or after."""
    frame = bytes([0x82, 3]) + b"two"

    async def talk(socket: web.WebSocketResponse) -> None:
        await socket.send_frame(b"one", WSMsgType.BINARY)
        socket.aside.write(frame)
        await socket.send_frame(b"three", WSMsgType.BINARY)

    async with connected(talk) as client:
        assert [await client.receive_bytes() for _ in range(3)] == [b"one", b"two", b"three"]


async def test_the_writer_of_an_answer_waits_for_the_transport() -> None:
    """ViewerSocket.drained: what `prepare` returns knows of bytes that it has not written itself."""
    sizes: list[int] = []
    reads = asyncio.Event()

    async def talk(socket: web.WebSocketResponse) -> None:
        socket.aside.set_write_buffer_limits(high=0)
        socket.aside.write(b"\x82\x7f" + struct.pack("!Q", 8_000_000) + b"x" * 8_000_000)
        sizes.append(socket.aside.get_write_buffer_size())
        reads.set()
        await socket.stream.drain()
        sizes.append(socket.aside.get_write_buffer_size())

    async with connected(talk) as client:
        client._response.connection.transport.pause_reading()
        await reads.wait()
        client._response.connection.transport.resume_reading()
        await closed(client)
    before, after = sizes
    assert before > 0, "the system took all at once"
    assert after == 0


async def test_text_stays_bytes() -> None:
    """decode_text=False at both ends, and pings that aiohttp leaves alone."""
    received = []

    async def talk(socket: web.WebSocketResponse) -> None:
        received.extend([await socket.receive(), await socket.receive()])
        await socket.send_frame(b'"\xc3\xa9"', WSMsgType.TEXT)

    async with connected(talk, decode_text=False, autoping=False) as client:
        await client.send_frame(b"\xff", WSMsgType.PING)
        await client.send_frame(b"{}", WSMsgType.TEXT)
        message = await client.receive()
        assert (message.type, message.data) == (WSMsgType.TEXT, b'"\xc3\xa9"')
    assert [(message.type, message.data) for message in received] == [
        (WSMsgType.PING, b"\xff"),
        (WSMsgType.TEXT, b"{}"),
    ]


async def test_a_receive_that_is_cancelled_leaves_the_message() -> None:
    """Bridge reads ahead while a message waits, and goes on reading itself when that one is through."""
    got: list[str] = []

    async def talk(socket: web.WebSocketResponse) -> None:
        while len(got) < 500:
            receiving = asyncio.create_task(socket.receive())
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            receiving.cancel()
            (message,) = await asyncio.gather(receiving, return_exceptions=True)
            if not isinstance(message, BaseException):
                got.append(message.data)

    async with connected(talk) as client:
        for number in range(500):
            await client.send_str(str(number))
            await asyncio.sleep(0)
        await closed(client)
    assert got == [str(number) for number in range(500)]


async def test_a_request_that_cannot_be_parsed_is_logged_with_its_exception(caplog) -> None:
    """relay/app.py's WithoutRequest takes such a request out of the log by the exception's class."""
    logger = logging.getLogger("test_aiohttp")

    async def never(_request: web.BaseRequest) -> web.StreamResponse:
        raise AssertionError

    runner = web.ServerRunner(web.Server(never, access_log=None, logger=logger))
    await runner.setup()
    await web.TCPSite(runner, HOST, 0).start()
    try:
        with caplog.at_level(logging.DEBUG, logger.name):
            reader, writer = await asyncio.open_connection(*runner.addresses[0][:2])
            writer.write(b"GET /?ticket=secret\x00 HTTP/1.1\r\nHost: h\r\n\r\n")
            assert (await reader.readline()).startswith(b"HTTP/1.0 400")
            writer.close()
    finally:
        await runner.cleanup()
    [record] = [item for item in caplog.records if item.name == logger.name]
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], HttpProcessingError)


ASKS = """
import asyncio, ssl, sys
import robotether_agent.cli
import aiohttp
from aiohttp import connector

contexts = connector._SSL_CONTEXT_VERIFIED, connector._SSL_CONTEXT_UNVERIFIED
assert [context.cert_store_stats()["x509"] for context in contexts] == [0, 0]
assert contexts[0].check_hostname
assert contexts[0].verify_mode is ssl.CERT_REQUIRED

async def ask():
    async with aiohttp.ClientSession() as session:
        for _ in range(2):
            async with session.get(sys.argv[1]) as answer:
                print(answer.status)

asyncio.run(ask())
"""


@pytest.mark.parametrize(
    ("trusted", "told"), [(True, "200\n200\n"), (False, "certificate verify failed: self-signed")]
)
async def test_the_agent_reads_the_systems_certificates_with_the_first_connection(
    trusted: bool, told: str
) -> None:
    """Then it trusts them, and nobody else."""

    async def answer(_: web.BaseRequest) -> web.Response:
        return web.Response()

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate())
    runner = web.ServerRunner(web.Server(answer, access_log=None), shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, HOST, 0, ssl_context=context).start()
    system = {
        "SSL_CERT_FILE": str(certificate()) if trusted else "/dev/null",
        "SSL_CERT_DIR": "/dev/null",
    }
    try:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-c", ASKS, f"https://localhost:{runner.addresses[0][1]}/"),
            env={**os.environ, "PYTHONPATH": ":".join(sys.path), **system},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        out, _ = await process.communicate()
    finally:
        await runner.cleanup()
    assert told in out.decode()

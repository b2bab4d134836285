"""What relay and agent use of aiohttp beyond its documentation, where the tests of that code would not notice a change.

pyproject.toml of agent and server bound the version: raise the bound when these tests and server/relay/http pass.
"""

import asyncio
import inspect
import os
import re
import ssl
import sys
from contextlib import asynccontextmanager

import pytest
from aiohttp import (
    ClientSession,
    ClientWebSocketResponse,
    web,
)
from fake_cloud import certificate
from robotether_agent.guard import process as _guard_sockets  # noqa: F401 - for its classes
from robotether_server.relay import main as _relay_sockets  # noqa: F401 - for its classes

HOST = "127.0.0.1"
WAIT_S = 30
ASSIGNED = re.compile(r"\bself\.(\w+)(?:: [^=\n]+)? = ")
# OperatorSocket closes in its own way, and only when told to, and sends each of these behind a large message.
OVERRIDDEN = {"close", "ping", "pong", "send_frame"}
OWN = {"OperatorSocket", "ViewerSocket", "RobotSocket", "ClientSocket", "RosbridgeSocket"}


def own_classes():
    """Every class of the product that is one of aiohttp's WebSockets."""
    left = [web.WebSocketResponse, ClientWebSocketResponse]
    found = []
    while left:
        left += (below := left.pop().__subclasses__())
        found += [item for item in below if item.__module__.startswith("robotether_")]
    return found


def names_of(cls):
    """The methods of one class, and the attributes that it sets."""
    methods = {name for name in vars(cls) if not name.startswith(("__", "_abc_"))}
    return methods | set(ASSIGNED.findall(inspect.getsource(cls)))


def test_our_names_are_free_in_aiohttps_classes():
    """An attribute of ours that a new aiohttp has too would replace its own."""
    assert {cls.__name__ for cls in own_classes()} >= OWN
    for cls in own_classes():
        bases = [base for base in cls.__mro__ if base.__module__.startswith("aiohttp.")]
        theirs = set().union(*(names_of(base) for base in bases))
        assert names_of(cls) & theirs - OVERRIDDEN == set(), cls.__qualname__


@asynccontextmanager
async def serving(answer, context=None):
    """Serve on a port of this machine."""
    runner = web.ServerRunner(web.Server(answer, access_log=None), shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, HOST, 0, ssl_context=context).start()
    try:
        yield runner.addresses[0][1]
    finally:
        await runner.cleanup()


@asynccontextmanager
async def connected(talk):
    """A client's WebSocket to a server that talks as a test says, and then closes."""

    async def handle(request):
        socket = web.WebSocketResponse(compress=False, autoclose=False)
        await socket.prepare(request)
        await talk(socket)
        return socket

    async with (
        serving(handle) as port,
        ClientSession() as session,
        asyncio.timeout(WAIT_S),
        session.ws_connect(f"http://{HOST}:{port}/", autoclose=False) as client,
    ):
        yield client


async def test_a_receive_that_is_cancelled_leaves_the_message():
    """Bridge reads ahead while a message waits, and goes on reading itself when that one is through."""
    got = []

    async def talk(socket):
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
        await client.receive()
    assert got == [str(number) for number in range(500)]


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
    ("trusted", "expected"),
    [(True, "200\n200\n"), (False, "certificate verify failed: self-signed")],
)
async def test_the_agent_trusts_the_systems_certificates(trusted, expected):
    """It reads them with the first connection, and trusts nobody else."""

    async def answer(_):
        return web.Response()

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate())
    file = str(certificate()) if trusted else "/dev/null"
    system = {"SSL_CERT_FILE": file, "SSL_CERT_DIR": "/dev/null"}
    async with serving(answer, context) as port:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-c", ASKS, f"https://localhost:{port}/"),
            env={**os.environ, "PYTHONPATH": ":".join(sys.path), **system},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        out, _ = await process.communicate()
    assert expected in out.decode()

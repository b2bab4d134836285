"""TCP connections to one of a host's addresses, and a look at what comes first on them.

Used by the way. A connection is returned or closed; nothing is read from it that somebody else may have to read.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from robotether_agent.net.happy_eyeballs import HappyEyeballs, after
from robotether_agent.net.resolver import Address, Resolver
from robotether_agent.net.socket_options import prepare
from robotether_agent.problems import NoAnswer, ServerUnreachable
from robotether_agent.tasks import within

# A first packet that is lost is sent again after 1 s; a second loss is left to the next attempt.
CONNECT_TIMEOUT_S = 3.0
# RFC 8305 recommends it for the pause between two addresses.
STAGGER_S = 0.25
CHECK_NETWORK = "check this robot's network, and that the server lets this port in"


async def connect(host: str, port: int, resolver: Resolver, name: str) -> socket.socket:
    """Return a connection to `host` at whichever of its addresses answers first; problems call it `name`."""
    try:
        addresses = await resolver.addresses(host, port)
    except OSError as error:
        raise NoAnswer(f"cannot reach {name}: {error}", advice=CHECK_NETWORK) from error
    attempts = [partial(_connect, address, name) for address in addresses]
    return await HappyEyeballs(attempts, pause=after(STAGGER_S), drop=socket.socket.close).winner()


async def _connect(address: Address, name: str) -> socket.socket:
    family, where = address
    try:
        with ExitStack() as unless_connected:
            connection = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
            unless_connected.callback(connection.close)
            prepare(connection)
            connecting = asyncio.get_running_loop().sock_connect(connection, where)
            await within(CONNECT_TIMEOUT_S, connecting)
            unless_connected.pop_all()
            return connection
    except asyncio.TimeoutError as error:
        why = f"{where[0]} does not answer in {CONNECT_TIMEOUT_S:g} s"
        raise NoAnswer(f"cannot reach {name}: {why}", advice=CHECK_NETWORK) from error
    except ConnectionRefusedError as error:
        why = f"{where[0]} refuses the connection"
        raise ServerUnreachable(f"cannot reach {name}: {why}", advice=CHECK_NETWORK) from error
    except OSError as error:
        why = f"{where[0]}: {error.strerror or error}"
        raise NoAnswer(f"cannot reach {name}: {why}", advice=CHECK_NETWORK) from error


async def peek(connection: socket.socket, is_enough: Callable[[bytes], bool], limit: int) -> bytes:
    """Return what has come so far, and leave it there, once it is enough or `limit` bytes.

    Raises ConnectionError when the other side ends the connection before.
    """
    seen = b""
    try:
        while True:
            # Readable then means: more than what was seen already, or the end.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, len(seen) + 1)
            await _readable(connection)
            now = connection.recv(limit, socket.MSG_PEEK | socket.MSG_DONTWAIT)
            if len(now) == len(seen):
                raise ConnectionResetError("the connection was closed")
            seen = now
            if is_enough(seen) or len(seen) >= limit:
                return seen
    finally:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, 1)


async def _readable(connection: socket.socket) -> None:
    loop = asyncio.get_running_loop()
    readable = asyncio.Event()
    loop.add_reader(connection, readable.set)
    try:
        await readable.wait()
    finally:
        loop.remove_reader(connection)

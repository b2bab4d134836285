"""TCP connections: whichever address answers, and a look that takes nothing."""

from __future__ import annotations

import asyncio
import socket

import pytest
from local_network import free_port
from robotether_agent.net.resolver import Resolver
from robotether_agent.net.tcp import connect, peek
from robotether_agent.problems import NoAnswer, ServerUnreachable
from ssh_doors import BANNER, Door


def at(*addresses: str):
    """A resolver that knows these addresses of every name."""
    return Resolver(lambda _, port: [(socket.AF_INET, (address, port)) for address in addresses])


@pytest.fixture
def pair():
    """Two ends of a TCP connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        other, _ = server.accept()
    one.setblocking(False)
    with one, other:
        yield one, other


async def test_an_address_that_refuses_is_passed_over():
    async with Door() as door:
        with await connect("h", door.port, at("127.0.0.2", "127.0.0.1"), "it") as connection:
            assert connection.getpeername() == ("127.0.0.1", door.port)
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


async def test_all_addresses_refuse():
    """A refusal is an answer: the name and each address are told."""
    with pytest.raises(ServerUnreachable, match=r"cannot reach it: .*127.0.0.2 refuses"):
        await connect("h", free_port(), at("127.0.0.1", "127.0.0.2"), "it")


async def test_an_unknown_name():
    """Without an address nothing has answered."""

    def unknown(*_: object):
        raise socket.gaierror(-2, "Name or service not known")

    with pytest.raises(NoAnswer, match=r"cannot reach it: .*not known"):
        await connect("h", 22, Resolver(unknown), "it")


async def test_no_route_to_the_address():
    """What the kernel knows not to work is no answer either."""
    with pytest.raises(NoAnswer, match=r"240\.0\.0\.1|255\.255"):
        await connect("h", 22, at("255.255.255.255"), "it")


async def test_a_look_takes_nothing(pair):
    """What was seen is still there for whoever gets the connection."""
    ours, theirs = pair
    theirs.send(BANNER)
    assert await peek(ours, lambda seen: len(seen) >= 4, 64) == BANNER
    assert ours.recv(64) == BANNER


async def test_a_look_waits_for_enough(pair):
    """Half of what is wanted is not taken for the whole, and costs no processor time."""
    ours, theirs = pair
    theirs.send(b"SS")
    looking = asyncio.ensure_future(peek(ours, lambda seen: len(seen) >= 4, 64))
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(asyncio.shield(looking), 0.1)
    theirs.send(b"H-")
    assert await asyncio.wait_for(looking, 5) == b"SSH-"


async def test_a_look_at_what_was_closed(pair):
    """The end before enough came is an error."""
    ours, theirs = pair
    theirs.send(b"SS")
    theirs.close()
    with pytest.raises(ConnectionError):
        await asyncio.wait_for(peek(ours, lambda seen: len(seen) >= 4, 64), 5)


async def test_a_look_is_bounded(pair):
    """Whoever sends without end is not waited for."""
    ours, theirs = pair
    theirs.send(b"x" * 1000)
    assert len(await asyncio.wait_for(peek(ours, lambda _: False, 100), 5)) == 100

"""TCP connections to the server: its name, its addresses, and what the kernel is told of them."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from robotether_agent.net import tcp
from robotether_agent.net.tcp import (
    Resolver,
    connect,
    interleaved,
    is_established,
    is_stuck,
    prepare,
)
from ssh_ports import SshPort

FOUR = [(socket.AF_INET, (f"192.0.2.{number}", 22)) for number in (1, 2)]
SIX = [(socket.AF_INET6, (f"2001:db8::{number}", 22, 0, 0)) for number in (1, 2, 3)]


def option(connection: socket.socket, number: int) -> int:
    return connection.getsockopt(socket.IPPROTO_TCP, number)


def test_a_dead_path_is_given_up_in_seconds(connection):
    prepare(connection)
    assert option(connection, socket.TCP_NODELAY)
    assert option(connection, tcp.TCP_USER_TIMEOUT) == tcp.USER_TIMEOUT_MS


def test_a_live_path_is_not_stuck(connection):
    connection.send(b"hello")
    assert not is_stuck(connection)
    assert is_established(connection)
    connection.close()
    assert not is_stuck(connection)
    assert not is_established(connection)


class NameService:
    def __init__(self) -> None:
        self.answer: list | OSError = FOUR
        self.free = threading.Event()
        self.free.set()
        self.asked = 0

    def __call__(self, host: str, port: int) -> list:
        self.asked += 1
        answer = self.answer
        assert self.free.wait(10)
        if isinstance(answer, OSError):
            raise answer
        return answer

    @contextmanager
    def hanging(self) -> Iterator[None]:
        self.free.clear()
        try:
            yield
        finally:
            self.free.set()


@pytest.fixture
def names() -> NameService:
    return NameService()


def test_families_take_turns():
    """The resolver's first choice comes first, then the other family, as far as they go."""
    assert interleaved(SIX + FOUR) == [SIX[0], FOUR[0], SIX[1], FOUR[1], SIX[2]]
    assert interleaved(FOUR) == FOUR


async def test_an_answer_that_comes_late_counts_the_next_time(names):
    """What a hanging question brings at last is used when the next one hangs."""
    known = Resolver(names)
    await known.addresses("h", 22)
    names.answer = SIX
    with names.hanging():
        assert await known.addresses("h", 22) == FOUR
    deadline = asyncio.get_running_loop().time() + 5
    while known._last["h", 22] != SIX:
        assert asyncio.get_running_loop().time() < deadline
        await asyncio.sleep(0.01)
    names.answer = OSError("gone")
    assert await known.addresses("h", 22) == SIX


async def test_questions_that_hang_do_not_pile_up(names, monkeypatch):
    monkeypatch.setattr(tcp, "CACHED_TIMEOUT_S", 0.01)
    known = Resolver(names)
    await known.addresses("h", 22)
    with names.hanging():
        for _ in range(3 * tcp.THREADS):
            await known.addresses("h", 22)
        assert names.asked == 1 + tcp.THREADS


async def test_a_name_service_that_never_answered(names, monkeypatch):
    monkeypatch.setattr(tcp, "RESOLVE_TIMEOUT_S", 0.05)
    with names.hanging(), pytest.raises(OSError, match="no answer from the name service"):
        await Resolver(names).addresses("h", 22)


def at(*addresses: str):
    return Resolver(lambda _, port: [(socket.AF_INET, (address, port)) for address in addresses])


async def test_an_address_that_refuses_is_passed_over():
    async with SshPort() as door:
        with await connect("h", door.port, at("127.0.0.2", "127.0.0.1"), "it") as connection:
            assert connection.getpeername() == ("127.0.0.1", door.port)
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)

"""Names: asked anew each time, and never waited for without need."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from robotether_agent.net import resolver
from robotether_agent.net.resolver import Resolver, interleaved, resolve

FOUR = [(socket.AF_INET, (f"192.0.2.{number}", 22)) for number in (1, 2)]
SIX = [(socket.AF_INET6, (f"2001:db8::{number}", 22, 0, 0)) for number in (1, 2, 3)]


class NameService:
    """Answers as the test says, or hangs until it is let go."""

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


def test_addresses_need_no_name_service():
    """What is an address already comes back, in either family."""
    assert resolve("127.0.0.1", 22) == [(socket.AF_INET, ("127.0.0.1", 22))]
    assert resolve("::1", 22)[0][0] == socket.AF_INET6


async def test_it_is_asked_each_time(names):
    known = Resolver(names)
    assert await known.addresses("h", 22) == FOUR
    names.answer = SIX
    assert await known.addresses("h", 22) == SIX


async def test_the_last_address_is_tried_while_the_name_service_is_silent(names):
    """A resolver without a network may hang for long; it holds up nothing."""
    known = Resolver(names)
    await known.addresses("h", 22)
    with names.hanging():
        assert await asyncio.wait_for(known.addresses("h", 22), 2) == FOUR


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
    """Only so many threads wait for a name service, however often it is asked."""
    monkeypatch.setattr(resolver, "CACHED_TIMEOUT_S", 0.01)
    known = Resolver(names)
    await known.addresses("h", 22)
    with names.hanging():
        for _ in range(3 * resolver.THREADS):
            await known.addresses("h", 22)
        assert names.asked == 1 + resolver.THREADS


async def test_an_unknown_name(names):
    names.answer = socket.gaierror(-2, "Name or service not known")
    with pytest.raises(OSError, match=r"cannot find the address of h: .*not known"):
        await Resolver(names).addresses("h", 22)


async def test_a_name_service_that_never_answered(names, monkeypatch):
    """Nothing can be tried, and that is said in time."""
    monkeypatch.setattr(resolver, "TIMEOUT_S", 0.05)
    with names.hanging(), pytest.raises(OSError, match="no answer from the name service"):
        await Resolver(names).addresses("h", 22)

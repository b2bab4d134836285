"""Waiting for a port, with real listeners."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest_asyncio
from fake_robot import HOST
from local_network import free_port
from robotether_server.relay.robots.ports import wait_released


class Listener:
    """Somebody who holds a port, and counts who asks."""

    def __init__(self) -> None:
        self.asked = 0
        self.asked_twice = asyncio.Event()
        self.port = 0

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._accept, HOST, 0)
        self.port = self._server.sockets[0].getsockname()[1]

    def close(self) -> None:
        self._server.close()

    def _accept(self, _reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()
        self.asked += 1
        if self.asked == 2:
            self.asked_twice.set()


@pytest_asyncio.fixture
async def listener() -> AsyncIterator[Listener]:
    """A port that is taken."""
    listener = Listener()
    await listener.start()
    yield listener
    listener.close()


async def test_a_free_port_is_not_waited_for():
    """Nobody accepts: True, even with no time to wait."""
    assert await wait_released(HOST, free_port(), within_s=0)


async def test_a_port_that_stays_taken_is_given_up(listener):
    """Somebody accepts all the time: False when the time is over, after several looks."""
    loop = asyncio.get_running_loop()
    begun = loop.time()
    assert not await wait_released(HOST, listener.port, within_s=0.2)
    assert 0.2 <= loop.time() - begun < 1
    assert listener.asked > 2


async def test_a_port_is_seen_free_at_once(listener):
    """The wait ends with the release, and not with its time."""
    waiting = asyncio.create_task(wait_released(HOST, listener.port, within_s=30))
    await asyncio.wait_for(listener.asked_twice.wait(), 5)
    assert not waiting.done()
    listener.close()
    assert await asyncio.wait_for(waiting, 2)


async def test_a_host_that_is_away_holds_no_port():
    """When sshd itself cannot be found, no port of it is taken."""
    assert await wait_released("no-such-host.invalid", 20000, within_s=0)

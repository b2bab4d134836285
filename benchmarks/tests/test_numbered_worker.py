"""The load generator sends each message once and on time, and goes on after a connection ended, at a real rosbridge."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import aiohttp
import pytest
from local_network import free_port
from paper.bus_robot import BusRobot
from paper.numbered.messages import Histogram
from paper.numbered.worker import End, Receiver, Sender

ADDRESS = "127.0.0.1"
ARRIVES_WITHIN_S = 10.0


class OnePair:
    """A sender and a receiver of `count` messages at one rosbridge."""

    def __init__(self, http: aiohttp.ClientSession, port: int, count: int, rate_hz: float) -> None:
        def end(*, sends: bool) -> End:
            return End(
                pair=3,
                count=count,
                rate_hz=rate_hz,
                sends=sends,
                namespace="",
                url=f"ws://{ADDRESS}:{port}/",
            )

        self.receiver = Receiver(end(sends=False), http)
        self.sender = Sender(end(sends=True), http)

    async def send_all(self) -> dict[str, Any]:
        """Send them from now on, and return what became of it."""
        await self.sender.run(time.monotonic_ns())
        return self.sender.result()

    async def received(self, count: int) -> dict[str, Any]:
        """What came, as soon as that is so many."""
        async with asyncio.timeout(ARRIVES_WITHIN_S):
            while True:
                if self.receiver.account.received >= count:
                    return self.receiver.result()
                await asyncio.sleep(0.01)


@asynccontextmanager
async def one_pair(port: int, count: int, rate_hz: float) -> AsyncIterator[OnePair]:
    async with aiohttp.ClientSession() as http:
        pair = OnePair(http, port, count, rate_hz)
        ends = (pair.receiver.dialled, pair.sender.dialled)
        for end in ends:
            await end.dial()
        try:
            yield pair
        finally:
            for end in ends:
                await end.close()


@pytest.fixture
def port() -> int:
    return free_port()


async def test_a_sender_that_is_held_up_hides_no_latency(port: int) -> None:
    async with BusRobot(ADDRESS, port), one_pair(port, 50, 100) as pair:
        sending = asyncio.create_task(pair.send_all())
        await asyncio.sleep(0.1)
        # The loop of this test is that of the sender.
        time.sleep(0.3)  # noqa: ASYNC251
        await sending
        arrived = await pair.received(50)
    assert (Histogram(arrived["latency"]).quantile_ms(0.7) or 0) > 50


async def test_a_connection_that_ended_is_dialled_again_and_counted(port: int) -> None:
    async with BusRobot(ADDRESS, port) as ros, one_pair(port, 400, 200) as pair:
        keeping = asyncio.create_task(pair.receiver.dialled.keep())
        sending = asyncio.create_task(pair.send_all())
        await pair.received(20)
        await ros.__aexit__()
        async with BusRobot(ADDRESS, port):
            sent = await sending
            keeping.cancel()
            await asyncio.gather(keeping, return_exceptions=True)
            arrived = pair.receiver.result()
    assert (sent["sent"], sent["unsent"]) == (400, 0)
    assert sent["redials"] >= 1
    assert arrived["redials"] >= 1
    assert sent["endings"] == ["close code 1001"]
    assert arrived["duplicated"] == 0

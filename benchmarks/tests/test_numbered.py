"""Numbered messages are counted, and their latencies told, exactly as they came."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

import aiohttp
import pytest
from local_network import free_port
from paper.bus_robot import BusRobot
from paper.numbered.messages import Account, joined, publish
from paper.numbered.worker import End, Receiver, Sender


def text(pair: int, number: int, due_ns: int = 0) -> str:
    """What a subscriber gets of such a message."""
    return str(json.loads(publish(pair, number, due_ns))["msg"]["data"])


def account(*numbers: int, count: int = 4) -> Account:
    """One in which these came, in this order."""
    made = Account(pair=1, count=count)
    for number in numbers:
        made.note(text(1, number), 1_000_000)
    return made


def test_what_is_missing_is_named() -> None:
    kept = account(0, 2)
    assert not kept.complete
    assert kept.as_json()["missing"] == [1, 3]


def test_a_second_copy_is_a_duplicate_and_no_more() -> None:
    kept = account(0, 1, 2, 1, 1)
    assert (kept.received, kept.duplicated, kept.reordered, kept.latency.total) == (3, 2, 0, 3)


def test_what_a_later_one_overtook_is_reordered() -> None:
    assert account(3, 0, 1, 2).reordered == 3
    assert account(0, 2, 1, 3).reordered == 1


@pytest.mark.parametrize("data", [text(2, 0), text(1, 4), text(1, -1), "", "hello", "1 2", "1 2 x"])
def test_what_is_of_nobody_here_is_foreign(data: str) -> None:
    kept = Account(pair=1, count=4)
    kept.note(data, 0)
    assert (kept.foreign, kept.received) == (1, 0)


def test_a_run_is_the_sum_of_its_pairs() -> None:
    steady: dict[str, Any] = {"failed_dials": 0, "dial_failures": []}
    late = {"failed_dials": 1, "dial_failures": ["4505"], "lateness": {"0.10": 1, "9.00": 2}}
    sent = [{**steady, "sent": 4, "lateness": {"0.10": 4}}, {**late, "sent": 3}]
    arrived = [{**account(*numbers).as_json(), **steady} for numbers in ((0, 1, 2, 3), (0, 2))]
    run = joined(sent, arrived)
    assert (run["sent"], run["received"], run["lost"]) == (7, 6, 1)
    assert run["missing"] == {"1": [1, 3]}
    assert (run["failed_dials"], run["dial_failures"]) == (1, ["4505"])
    assert run["lateness"] == {"0.10": 5, "9.00": 2}
    assert run["latency"] == {"1.00": 6}


async def test_a_sender_that_is_held_up_hides_no_latency() -> None:
    port, pair = free_port(), {"pair": 3, "count": 50, "rate_hz": 100}
    async with BusRobot("127.0.0.1", port), aiohttp.ClientSession() as http:
        url = f"ws://127.0.0.1:{port}/"
        receiver = Receiver(End(**pair, sends=False, url=url), http)
        sender = Sender(End(**pair, sends=True, url=url), http)
        for item in (receiver, sender):
            await item.connection.dial()
        sending = asyncio.create_task(sender.run(time.monotonic_ns()))
        await asyncio.sleep(0.1)
        # The loop of this test is that of the sender.
        time.sleep(0.3)  # noqa: ASYNC251
        await sending
        async with asyncio.timeout(10):
            while not receiver.account.complete:  # noqa: ASYNC110 (it has no event)
                await asyncio.sleep(0.01)
        for item in (receiver, sender):
            await item.connection.close()
    assert (receiver.account.latency.quantile_ms(0.7) or 0) > 50

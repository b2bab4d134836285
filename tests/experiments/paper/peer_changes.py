"""How soon a message passes on any of the ways that are compared: after the robot's start, and after a new address.

Nobody's protocol is asked whether it is connected; an operator tries as a program does that wants to drive, one attempt
after the other, and the first message that has come back from the robot counts.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine
from contextlib import suppress

import aiohttp

from paper.peer_echo import LAST_S, Echo, http_of, stop
from paper.peer_way import Way

# An attempt that went into nothing is given up for a new one; and all of it, which counts as never.
ATTEMPT_S, PAUSE_S, GIVE_UP_S = 0.5, 0.02, 60.0
HELD_HZ = 20
TELEMETRY, TELEMETRY_TYPE = "/odom", "nav_msgs/Odometry"


async def connect_s(way: Way) -> float | None:
    """Seconds from the start of the robot's client program to the first message that came back; None: never."""
    since = time.monotonic()
    await asyncio.to_thread(way.connect)
    return await first_answer_s(way, since)


async def first_answer_s(way: Way, since: float) -> float | None:
    """Seconds from `since` until a message on a new connection has come back; None after GIVE_UP_S."""
    while time.monotonic() < since + GIVE_UP_S:
        with suppress(aiohttp.ClientError, OSError, TimeoutError, TypeError):
            return await asyncio.wait_for(_attempt(way), ATTEMPT_S) - since
        way.check()
        await asyncio.sleep(PAUSE_S)
    return None


async def _attempt(way: Way) -> float:
    """The moment at which a message has come back on a connection that is made for it."""
    async with http_of(way) as http:
        await Echo.open(http, way)
        return time.monotonic()


async def recover_s(way: Way, after_s: float) -> float | None:
    """Seconds from the robot's new address until a message passes, on the connection that was there or on a new one.

    The connection has stood for `after_s`, with messages both ways all the time; None: never.
    """
    async with http_of(way) as http:
        held = await asyncio.wait_for(Echo.open(http, way), LAST_S)
        # What a robot says by itself shows some ways where it is now.
        await held.tell("subscribe", TELEMETRY, TELEMETRY_TYPE)
        holding = asyncio.ensure_future(_hold(held))
        try:
            await asyncio.wait([holding], timeout=after_s)
            if holding.done():
                holding.result()
            await asyncio.to_thread(way.readdress)
            since = time.monotonic()
            return await _first(_held_answer_s(held, holding, since), first_answer_s(way, since))
        finally:
            await stop(holding)


async def _hold(held: Echo) -> None:
    """Send and take messages until the connection ends."""
    taking = asyncio.ensure_future(_take(held))
    try:
        number = 0
        while not taking.done():
            await held.send(number)
            number += 1
            await asyncio.wait([taking], timeout=1 / HELD_HZ)
        taking.result()
    finally:
        await stop(taking)


async def _take(held: Echo) -> None:
    while True:
        await held.receive()


async def _held_answer_s(held: Echo, holding: asyncio.Future[None], since: float) -> float | None:
    """Seconds until a message that was sent after `since` has come back; None when the connection ended, or never."""
    while held.answered_of < since:
        if holding.done() or time.monotonic() > since + GIVE_UP_S:
            return None
        await asyncio.sleep(PAUSE_S)
    return time.monotonic() - since


async def _first(*ways: Coroutine[None, None, float | None]) -> float | None:
    """What the first of these gives that gives something; the others are ended."""
    tasks = [asyncio.ensure_future(way) for way in ways]
    try:
        for done in asyncio.as_completed(tasks):
            if (took_s := await done) is not None:
                return took_s
        return None
    finally:
        for task in tasks:
            await stop(task)
